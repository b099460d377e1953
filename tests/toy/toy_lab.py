"""A small study for tests of book-keeping, and ways to carry it out: in this process, or as `labbook` in another."""

import json
import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import labbook_toy
import typer.main
from typer import testing
from typer.testing import CliRunner

from labbook.cli import build
from labbook.lab import LabFolder
from labbook.lab.folder import EVALUATION, PICTURE
from labbook.run.runner import Runner
from labbook.run.summary import Summary
from labbook.study import Study, load

ROOT = Path(__file__).parents[2]

STUDY = """
name: toy-study
grains: {{shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: {count}}}
contact: {{law: hertz-mindlin, shear_modulus: 2 MPa, poisson_ratio: 0.25, friction: 0.5, restitution: 0.2}}
container: {{kind: wedge-hopper, width: 60 mm, height: 300 mm, thickness: 1.01 d, angle: 90 deg, orifice: 24 mm}}
sweep:
  container.orifice: "{orifices} mm"
replicates: {replicates}
numerics: {{dt: 10 us, steps_per_beat: 200, precision: double}}
measure: [flow_rate]
"""
WINDOW = "window: {start: 0.15, end: 0.6}"
"""Of the study: its bed is too low for one that ends by itself."""


def study_file(folder: Path, *more: str, count=200, orifices="[18, 24]", replicates=2) -> Path:
    """A study file in `folder`, with `more` lines at its end."""
    path = Path(folder) / "toy.yaml"
    text = STUDY.format(count=count, orifices=orifices, replicates=replicates)
    own = any(line.startswith(("window:", "feed:")) for line in more)
    path.write_text(text + "".join(f"{line}\n" for line in (more if own else (WINDOW, *more))))
    return path


def study(folder: Path, *more: str, **changes) -> Study:
    """The study of such a file."""
    return load(study_file(folder, *more, **changes))


def carry_out(asked: Study, lab: Path, **options) -> Summary:
    """Carry out a study on the toy backend in this process."""
    backend = options.pop("backend", None) or labbook_toy.Backend()
    return Runner(asked, LabFolder(lab), backend, **options).run()


def labbook(*words: object, check: bool = True, **environment: str):
    """`labbook WORDS` in this process, to its end; what it does not expect is raised."""
    ended = CliRunner().invoke(APP, list(map(str, words)), env=environment, catch_exceptions=False)
    if check and ended.exit_code:
        raise AssertionError(f"labbook {' '.join(map(str, words))} ended with {ended.exit_code}:\n{ended.output}")
    return ended


APP = build()
# all verbs with all their options are made once, not for each of a thousand commands
testing._get_command = cache(typer.main.get_command)  # pyright: ignore[reportPrivateImportUsage]


def start(
    *words: object, delay: float = 0.0, terminal: int | None = None, together: bool = False, **environment: str
) -> subprocess.Popen:
    """`labbook WORDS` in a process of its own, going; on a terminal if one is given, else with pipes: one for both
    streams if they are to be `together`."""
    folders = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tests/toy"), os.environ.get("PYTHONPATH", "")]
    path = os.pathsep.join(filter(None, folders))
    given = {**os.environ, "PYTHONPATH": path, "LABBOOK_TOY_DELAY": str(delay), **environment}
    command = [sys.executable, "-c", "from labbook.cli import main; main()", *map(str, words)]
    out = subprocess.PIPE if terminal is None else terminal
    err = subprocess.STDOUT if together else out
    return subprocess.Popen(command, env=given, stdin=terminal, stdout=out, stderr=err, text=True)


def arrays(folder: Path) -> dict[str, bytes]:
    """The bits of every array that a run left in its folder, by file and name."""
    import numpy as np

    found = {}
    for path in sorted(Path(folder).glob("*.npz")):
        if path.name.startswith(EVALUATION):
            continue
        with np.load(path) as stored:
            found |= {f"{path.name}/{name}": stored[name].tobytes() for name in stored.files}
    return found


def content(lab: Path) -> dict[str, dict[str, object]]:
    """All that is in the folders of a lab's runs and packings, bit for bit, by key and file; of records all but when
    and in which sessions they were made. What is evaluated of them is left out."""
    found: dict[str, dict[str, object]] = {}
    for folder in (path for kind in ("runs", "packings") for path in sorted((Path(lab) / kind).glob("*"))):
        files = [path for path in sorted(folder.iterdir()) if not path.name.startswith(EVALUATION)]
        found[folder.name] = {path.name: _content(path) for path in files}
    return found


def _content(path: Path) -> object:
    if path.name == PICTURE:
        return None
    if path.suffix != ".json":
        return path.read_bytes()
    try:
        record = json.loads(path.read_bytes())
    except ValueError:  # it is damaged
        return path.read_bytes()
    return {name: value for name, value in record.items() if name not in ("seal", "sessions", "finished")}


def unsealed(text: str) -> str:
    """The text of a record without its seal, as older labs have it: only then may anything in it be changed."""
    return re.sub(r'"seal": "[0-9a-f]{32}",\s*', "", text)


def leftovers(lab: Path) -> list[str]:
    """Locks, unfinished work and temporary files in a lab in which nobody works."""
    lab = Path(lab)
    found = [*(lab / "work").glob("*"), *(lab / "live").glob("*"), *lab.rglob("*.part")]
    return sorted(str(path.relative_to(lab)) for path in found)


@contextmanager
def within(seconds: int):
    """Fails what takes longer, such as a run without end."""

    def late(*_):
        raise AssertionError(f"not done within {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
