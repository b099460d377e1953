"""Every file of a finished run and its packing is cut off, deleted, or has one bit flipped, wherever: it is named."""

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from toy_lab import carry_out, labbook, study, study_file

from labbook.lab import Catalogue, LabFolder, Unreadable
from labbook.lab.index import Index
from labbook.lab.packings import read_packing
from labbook.lab.runs import open_run
from labbook.lab.tables import read_table

SMALL = {"count": 200, "orifices": "[24]", "replicates": 2}
RECORDED = "record: {every: 2 ms, replicates: 2}"
FILES = ("runs/run.json", "runs/crossing.npz", "runs/checkpoint.npz", "runs/recording.npz")
FILES += ("packings/packing.json", "packings/packing.npz")
PART = st.floats(0, 1, exclude_max=True)
HARM = st.one_of(st.just(("deleted", 0.0)), st.tuples(st.sampled_from(["cut", "flipped"]), PART))


def harmed(content: bytes, kind: str, where: float) -> bytes | None:
    """What is left of a file; None: it is deleted."""
    if kind == "deleted":
        return None
    if kind == "cut":
        return content[: int(where * len(content))]
    bit, bits = int(where * len(content) * 8), bytearray(content)
    bits[bit // 8] ^= 1 << bit % 8
    return bytes(bits)


def laid(path: Path, content: bytes | None) -> None:
    path.unlink(missing_ok=True)
    if content is not None:
        path.write_bytes(content)


def everything(folder: Path) -> Mapping[str, object] | Unreadable:
    """All that is read of a run or packing: its record, and the bits of every column; or why it cannot be read."""
    try:
        record = (open_run(folder) if folder.parent.name == "runs" else read_packing(folder))[0]
    except Unreadable as problem:
        return problem
    files = [path for path in sorted(folder.glob("*.npz")) if not path.name.startswith("measured-")]
    return {"record": record} | {
        f"{path.name} {name}": (column.dtype, column.tobytes())
        for path in files
        for name, column in read_table(path).items()
    }


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    carry_out(study(folder, RECORDED, **SMALL), folder / "lab")
    return folder


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize(
    "examples", [pytest.param(40, marks=pytest.mark.slow), pytest.param(1000, marks=pytest.mark.ring)]
)
def test_it_is_one_row_that_names_the_file_or_changes_nothing(sound, file, examples):
    """Zip files have bits that mean nothing, such as the system that wrote them: of these nothing is noticed."""
    kind, _, name = file.partition("/")
    victim = sorted((sound / "lab" / kind).iterdir())[0]
    content, right = (victim / name).read_bytes(), everything(victim)
    named = 0

    @settings(max_examples=examples, deadline=None, suppress_health_check=[HealthCheck.too_slow], database=None)
    @given(HARM)
    def check(harm):
        nonlocal named
        left = harmed(content, *harm)
        laid(victim / name, left)
        try:
            now = everything(victim)
            if isinstance(now, Unreadable):
                assert str(victim / name) in str(now)
                named += 1
            else:
                assert now == right, "what can be read is what was written"
                assert name.endswith(".npz"), "records have a seal"
        finally:
            laid(victim / name, content)

    check()
    assert named > examples / 4


@pytest.mark.slow
@pytest.mark.usefixtures("one_format")
@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("kind", ["deleted", "cut", "flipped"])
def test_every_verb_says_so_and_none_fails(sound, tmp_path, file, kind):
    shutil.copytree(sound / "lab", tmp_path / "lab")
    lab, of = LabFolder(tmp_path / "lab"), file.partition("/")
    victim = sorted((lab.folder / of[0]).iterdir())[0] / of[2]
    rng = np.random.default_rng(len(file))
    left = harmed(victim.read_bytes(), kind, float(rng.uniform(0.3, 0.6)))  # among the data of a table
    laid(victim, left)
    asked = study_file(tmp_path, RECORDED, **SMALL)
    told = labbook("report", asked, "--lab", lab.folder, "--backend", "toy")
    assert str(victim) in told.output.replace("\n", "")
    index = Index(lab)
    assert any(str(victim) in problem for problem in index.report.problems)
    index.close()
    catalogue = Catalogue(lab)
    assert len(catalogue.damaged()) == 1, "one row"
    assert catalogue.counts() == {"finished": 1, "unreadable": 1}
    catalogue.close()
    for verb in ("status", "runs", "reindex"):
        assert str(victim) in labbook(verb, "--lab", lab.folder).output.replace("\n", ""), verb
    assert str(victim) in labbook("fit", asked, "--lab", lab.folder, "--backend", "toy").output.replace("\n", "")
