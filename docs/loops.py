"""Loops of the gallery: beds in motion, of the studies that ship, with few grains.

    python docs/loops.py [STUDY...]

Runs the first point of each study with few grains, as tests/unit/run/test_small_studies.py makes studies small, and
writes docs/loops/STUDY.webp of at most LARGEST bytes. All of them take some five minutes on two cores.
"""

import importlib.util
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from labbook_numba import Backend

from labbook.export.film import shot_of_run
from labbook.export.loop import encoded
from labbook.lab import Catalogue, LabFolder
from labbook.run.runner import Runner
from labbook.study import Study, load
from labbook.study.schema import Record

ROOT = Path(__file__).parents[1]
OUT = ROOT / "docs" / "loops"
LARGEST = 80_000
"""Bytes of a loop."""
LEFT_OUT = ("accuracy-", "clogging-", "pongo2022-clogging", "janssen-", "mixture-cone")
"""Beginnings of names: calibrations, studies whose small version does not clog, beds at rest, and one that is empty
after a few frames."""
SIZE, FRAMES, SECONDS = 150, (24, 12, 8), 4.0
"""Pixels of the longer side, numbers of frames to try until the file is small enough, and duration [s]."""
_EVERY = 0.01  # s between recorded frames


def main(names: Sequence[str]) -> None:
    """Make the loops of these studies; without names of all."""
    OUT.mkdir(exist_ok=True)
    for path in sorted((ROOT / "studies").glob("*.yaml")):
        if path.stem in names if names else not path.stem.startswith(LEFT_OUT):
            content = loop(_small(load(path)))
            if not content:
                raise SystemExit(f"{path.stem}: the loop has more than {LARGEST} bytes")
            (OUT / f"{path.stem}.webp").write_bytes(content)
            print(f"{path.stem}: {len(content) // 1000} kB", flush=True)


def loop(study: Study) -> bytes:
    """Run a study of one recorded run and draw its loop."""
    with TemporaryDirectory() as folder:
        lab = LabFolder(Path(folder))
        summary = Runner(study, lab, Backend(wide=True)).run()
        if summary.done != summary.requested:
            raise SystemExit(f"{study.name}: {summary.failed}")
        with closing(Catalogue(lab)) as catalogue:
            (key,) = catalogue.runs()["run_key"]
        shot = shot_of_run(lab.run(key), "layers")
        drawn = (encoded(shot, seconds=SECONDS, size=SIZE, frames=frames) for frames in FRAMES)
        return next((content for content in drawn if len(content) <= LARGEST), b"")


def _small(study: Study) -> Study:
    """The first point of a study with few grains and one recorded run."""
    small = _reduced(study)
    return replace(small, points=small.points[:1], replicates=1, record=Record(every=_EVERY, replicates=1))


def _reduced(study: Study) -> Study:
    path = ROOT / "tests/unit/run/test_small_studies.py"
    spec = importlib.util.spec_from_file_location("small_studies", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.reduced(study)


if __name__ == "__main__":
    main(sys.argv[1:])
