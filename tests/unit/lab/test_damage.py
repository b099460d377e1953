"""A folder that lacks or garbles anything is named by every verb, stops none, and is made again by the next run."""

import io
import json
import os
import shutil
import zipfile
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import arrays, carry_out, labbook, study, study_file, unsealed, within

from labbook.lab import Catalogue
from labbook.lab.tables import read_table

SMALL = {"count": 200, "orifices": "[24]", "replicates": 2}
RECORDED = "record: {every: 2 ms, replicates: 2}"
AT_REST = "fill: {settled_below: 1e-40}"  # so low that the toy backend takes some beats, and can save between them


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    """A folder with a study, a lab in which it is done, and two in which a filling or a run was cut short."""
    folder = tmp_path_factory.mktemp("sound")
    asked = study(folder, RECORDED, AT_REST, **SMALL)
    carry_out(asked, folder / "lab")
    cut_short(asked, folder / "filling", closed=True, beats=2)
    cut_short(asked, folder / "running", closed=False, beats=6)
    return folder


def cut_short(asked, lab: Path, *, closed: bool, beats: int) -> None:
    """Carry out a study, with a save at every beat, until so many were taken of fillings (closed) or of runs."""

    class CutShort(Backend):
        def open(self, spec, slots=None, device="cpu"):
            nonlocal beats
            ensemble = super().open(spec, slots, device)
            drain = ensemble.drain

            def counted():
                nonlocal beats
                beats -= spec.feature("closed") == closed
                if beats < 0:
                    raise KeyboardInterrupt
                return drain()

            ensemble.drain = counted
            return ensemble

    with pytest.raises(KeyboardInterrupt):
        carry_out(asked, lab, backend=CutShort(), checkpoint_every=0, workers=1)


@pytest.fixture
def place(sound, tmp_path) -> Path:
    shutil.copytree(sound, tmp_path / "here")
    return tmp_path / "here"


@pytest.fixture(scope="module")
def right(sound) -> dict:
    """What comes of the study where nothing is damaged."""
    return numbers(sound / "lab")


def numbers(lab: Path) -> dict:
    """All measured numbers, and the bits of all runs and packings."""
    catalogue = Catalogue(lab)
    measured = catalogue.measurements().drop(columns="note")
    catalogue.close()
    bits = {path.name: arrays(path) for kind in ("runs", "packings") for path in (lab / kind).iterdir()}
    return {"measured": measured.to_csv(), "bits": bits}


# kinds of damage


def missing(path: Path) -> None:
    path.unlink()


def empty(path: Path) -> None:
    path.write_bytes(b"")


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def garbage(path: Path) -> None:
    path.write_bytes(np.random.default_rng(1).bytes(path.stat().st_size))


def one_byte(path: Path) -> None:
    """In the middle of what is compressed: a checksum tells."""
    content = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        largest = max(archive.infolist(), key=lambda entry: entry.compress_size)
    content[largest.header_offset + 60 + largest.compress_size // 2] ^= 0xFF
    path.write_bytes(bytes(content))


def folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def dangling(path: Path) -> None:
    path.unlink()
    path.symlink_to("nowhere")


def changed(change):
    """Damage to the columns of an npz."""

    def damage(path: Path) -> None:
        columns = read_table(path)
        change(columns)
        buffer = io.BytesIO()
        np.savez(buffer, **columns)  # pyright: ignore[reportArgumentType]
        path.write_bytes(buffer.getvalue())

    damage.__name__ = change.__name__
    return damage


def spoilt(name: str, spoil):
    def without(columns: dict) -> None:
        columns[name] = spoil(columns[name])

    return without


def lacks(name: str):
    def damage(columns: dict) -> None:
        del columns[name]

    return changed(damage)


def nan(name: str):
    def spoil(column):
        column = np.array(column, float)
        column.flat[-1] = np.nan
        return column

    return changed(spoilt(name, spoil))


def shorter(name: str):
    return changed(spoilt(name, lambda column: column[:-1]))


def of_text(name: str):
    return changed(spoilt(name, lambda column: column.astype("U20")))


def shifted(name: str, by):
    return changed(spoilt(name, lambda column: column + by))


def fewer(columns: dict) -> None:
    """A table without its last row."""
    for name in columns:
        columns[name] = columns[name][:-1]


def pickled(path: Path) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, time=np.array([{}], object))
    path.write_bytes(buffer.getvalue())


def bomb(path: Path) -> None:
    """A file that declares more than there is memory for."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (2**40,)})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("time.npy", header.getvalue() + b"\0" * 10**6)


def says(**changes):
    """Damage to a JSON file: dotted names with new values."""

    def damage(path: Path) -> None:
        whole = json.loads(unsealed(path.read_text()))
        for name, value in changes.items():
            *parents, last = name.split("__")
            part = whole
            for parent in parents:
                part = part[parent]
            part[last] = value
        path.write_text(json.dumps(whole))

    return damage


BYTES = {"missing": missing, "empty": empty, "truncated": truncated, "garbage": garbage, "pipe": pipe}
BROKEN = {"missing": missing, "truncated": truncated}
ODD = {"folder": folder, "dangling": dangling}
JSON = {
    "nothing": lambda path: path.write_text("{}"),
    "list": lambda path: path.write_text("[]"),
    "deep": lambda path: path.write_text("[" * 100_000),
    "no sessions": says(sessions=[]),
}
TABLE = {
    "one byte": one_byte,
    "pickled": pickled,
    "bomb": bomb,
    "no time": lacks("time"),
    "nan time": nan("time"),
    "short id": shorter("id"),
    "text": of_text("x"),
    "late": shifted("step", 10**6),
    "ids": shifted("id", 200),
}
DAMAGES = {
    "runs/run.json": BYTES
    | ODD
    | JSON
    | {
        "seed": says(seed=2**70),
        "duration": says(coverage__duration=float("nan")),
        "crossed": says(coverage__crossed=10**6),
        "probe": says(coverage__probes=["what"]),
        "density": says(scene__grains__density=99999.0),
        "version": says(cache_version=7),
    },
    "runs/crossing.npz": BYTES | ODD | TABLE | {"fewer": changed(fewer)},
    "runs/checkpoint.npz": BYTES | {"one byte": one_byte, "bomb": bomb, "no meta": lacks("_meta")},
    "runs/recording.npz": BROKEN | TABLE,  # opened like other tables, and read column by column
    "packings/packing.json": BROKEN  # read like the record of a run
    | {"no sessions": says(sessions=[]), "seed": says(filling__seed=2**70), "dt": says(numerics__dt=1e-9)},
    "packings/packing.npz": BYTES
    | {"one byte": one_byte, "bomb": bomb, "nan": nan("x"), "no x": lacks("x"), "fewer": changed(fewer)},
}
CASES = [(file, name) for file, kinds in DAMAGES.items() for name in kinds]
QUICK = ("truncated", "one byte", "no x", "density", "another step")
"""Damages that `make check` does to every file that can have them; with all others it is long: they are slow."""


def each(cases):
    """Cases as parameters, by the name of the damage, which comes last."""
    return [pytest.param(*c, id="-".join(c), marks=[] if c[-1] in QUICK else [pytest.mark.slow]) for c in cases]


@pytest.mark.parametrize(("file", "name"), each(CASES))
def test_a_damaged_file_is_named_and_made_again(right, place, file, name):
    lab, asked = place / "lab", study_file(place, RECORDED, AT_REST, **SMALL)
    kind, _, of = file.partition("/")
    victim = sorted((lab / kind).iterdir())[0]
    DAMAGES[file][name](victim / of)
    with within(60):
        assert victim.name in labbook("plan", asked, "--lab", lab, "--backend", "toy", "--json").output
        ended = labbook("run", asked, "--lab", lab, "--backend", "toy")
    assert str(victim) in ended.output.replace("\n", ""), ended.output
    assert "made again" in " ".join(ended.output.split())
    assert "2 of 2 runs done" in ended.output
    assert numbers(lab) == right


FILES = [(file, name) for file in DAMAGES for name in ("missing", "truncated")]


@pytest.mark.parametrize(("file", "name"), each(FILES))
def test_every_verb_names_a_damaged_file_and_one_run_mends_it(place, file, name):
    lab, asked = place / "lab", study_file(place, RECORDED, AT_REST, **SMALL)
    kind, _, of = file.partition("/")
    victim = sorted((lab / kind).iterdir())[0]
    DAMAGES[file][name](victim / of)
    for verb in ("fit", "export"):
        ended = labbook(verb, asked, "--lab", lab, "--backend", "toy", check=False)
        assert victim.name in ended.output, (verb, ended.output)
    if kind == "runs":
        ended = labbook("show", victim.name, "--lab", lab, check=False)
        assert (ended.exit_code, str(victim) in ended.output) == (1, True), ended.output
        assert victim.name in labbook("runs", "--lab", lab).output
    ended = labbook("status", "--lab", lab)
    (line,) = [line for line in ended.output.splitlines() if "cannot be read" in line]
    assert (ended.exit_code, str(victim / of) in line) == (0, True), ended.output
    labbook("run", asked, "--lab", lab, "--backend", "toy")
    again = labbook("run", asked, "--lab", lab, "--backend", "toy")
    assert "2 of 2 runs done" in again.output.splitlines()


PROGRESS = (
    BYTES
    | JSON
    | {
        "no step": says(state={}),
        "endless step": lambda path: path.write_text(path.read_text().replace('"step": ', '"step": 1e999, "was": ')),
        "way out": says(checkpoint="../../../catalogue.db"),
        "number": says(number=-1),
    }
)
STATE = {"crossed": says(state__crossed=10**6), "probes": says(state__probes=["what"]), "film": says(state__film="{}")}
SAVED = BYTES | {"one byte": changed(spoilt("x", lambda x: x * np.nan)), "no meta": lacks("_meta"), "no x": lacks("x")}
SAVED |= {"another step": shifted("count", 1), "ids": shifted("ids", 200)}
OF_WORK = {
    ("running", "progress.json"): PROGRESS | STATE,
    ("running", "checkpoint-"): SAVED,
    ("running", "crossing-"): BYTES | TABLE | {"fewer": changed(fewer)},
    ("running", "recording-"): BROKEN | {name: TABLE[name] for name in ("no time", "late", "ids")},  # as crossings are
    ("filling", "progress.json"): BROKEN  # as that of a run, but for what a filling itself adds
    | {"quiet": says(state__quiet="often"), "at rest": says(state__quiet=10**9)},
    ("filling", "checkpoint-"): BROKEN | {name: SAVED[name] for name in ("one byte", "another step", "ids")},
}
WORKS = [(lab, file, name) for (lab, file), kinds in OF_WORK.items() for name in kinds]


@pytest.mark.parametrize(("which", "file", "name"), each(WORKS))
def test_damaged_unfinished_work_is_named_and_begun_again(right, place, which, file, name):
    lab, asked = place / which, study_file(place, RECORDED, AT_REST, **SMALL)
    (victim,) = (folder for folder in (lab / "work").iterdir() if folder.is_dir())
    files = [path for path in sorted(victim.iterdir()) if path.name.startswith(file)]
    holding = [path for path in files if path.suffix == ".json" or path.stat().st_size > 3500]
    OF_WORK[which, file][name]((holding or files)[-1])
    with within(60):
        assert victim.name in labbook("status", "--lab", lab).output
        if name == "truncated":
            labbook("plan", asked, "--lab", lab, "--backend", "toy")
        ended = labbook("run", asked, "--lab", lab, "--backend", "toy")
    assert "2 of 2 runs done" in ended.output
    if name != "missing" or file != "progress.json":  # without it nothing was saved
        assert str(victim) in ended.output.replace("\n", ""), ended.output
        assert "starts from step 0" in " ".join(ended.output.split())
    assert numbers(lab) == right
    assert not list((lab / "work").iterdir())


def test_unfinished_work_that_is_whole_is_gone_on_with(right, place):
    """So that what the damaged ones above are held against is not a start afresh as well."""
    for which in ("filling", "running"):
        ended = labbook(
            "run", study_file(place, RECORDED, AT_REST, **SMALL), "--lab", place / which, "--backend", "toy"
        )
        assert "Unreadable" not in ended.output
        assert ("continued from" in ended.output) == (which == "running"), "of fillings nobody is told"
        assert numbers(place / which) == right


@pytest.mark.usefixtures("one_format")
@pytest.mark.parametrize("file", ["recording.npz", pytest.param("crossing.npz", marks=pytest.mark.slow)])
def test_reports_and_recordings_leave_a_damaged_run_out(place, file):
    pytest.importorskip("rerun")
    lab, asked = place / "lab", study_file(place, RECORDED, AT_REST, **SMALL)
    victim, other = sorted((lab / "runs").iterdir())
    truncated(victim / file)
    for verb, *more in (("report",), ("export", "--vtk"), ("view", "--no-open"), ("fit", "--json")):
        ended = labbook(verb, asked, "--lab", lab, "--backend", "toy", *more)
        assert f"Left out: {victim / file}" in ended.output, verb
        assert other.name not in ended.stderr
    assert len(list((lab / "recordings").iterdir())) == 1
    assert str(victim / file) in (lab / "reports/toy-study/report.html").read_text()
    truncated(other / file)
    shutil.rmtree(lab / "recordings")
    for verb, *more in (("report",), ("export",), ("view", "--no-open")):
        ended = labbook(verb, asked, "--lab", lab, "--backend", "toy", *more, check=False)
        assert ended.exit_code == 1, "nothing is left to show"
        assert f"Left out: {other / file}" in ended.output
        assert "labbook run" in ended.output.splitlines()[-1]


def test_a_damaged_recording_that_kept_its_stamp_is_one_line(place, monkeypatch):
    """Bits may rot without a trace in the names, sizes and times of files, by which changes are noticed."""
    lab, asked = place / "lab", study_file(place, RECORDED, AT_REST, **SMALL)
    victim = sorted((lab / "runs").iterdir())[0]
    times = (victim / "recording.npz").stat()
    one_byte(victim / "recording.npz")
    os.utime(victim / "recording.npz", ns=(times.st_atime_ns, times.st_mtime_ns))
    ended = labbook("export", asked, "--lab", lab, "--backend", "toy", "--vtk", check=False)
    assert ended.exit_code == 1
    assert ended.stderr.count("\n") == 1
    assert str(victim / "recording.npz") in ended.stderr
    assert "labbook reindex" in ended.stderr
    assert victim.name in labbook("reindex", "--lab", lab).output
    assert "2 of 2 runs done" in labbook("run", asked, "--lab", lab, "--backend", "toy").output
    assert labbook("export", asked, "--lab", lab, "--backend", "toy", "--vtk").exit_code == 0


@pytest.fixture(scope="module")
def compared(tmp_path_factory) -> Path:
    """A folder with a lab in which two backends were compared."""
    folder = tmp_path_factory.mktemp("compared")
    assert "equivalent within 3 % in all 2 tests" in compare(folder)
    return folder


def compare(folder: Path) -> str:
    path = study_file(folder, count=400, orifices="[24]")
    return labbook("compare", path, "--lab", folder / "lab", "--backends", "toy,twin").stdout


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["runs", "packings"])
def test_a_comparison_makes_what_is_damaged_again(compared, tmp_path, kind):
    lab = shutil.copytree(compared / "lab", tmp_path / "lab")
    files = {"runs": ("crossing.npz", "checkpoint.npz"), "packings": ("packing.npz",)}[kind]
    for victim, file in zip(sorted((lab / kind).iterdir()), cycle(files), strict=False):
        garbage(victim / file)
    with within(60):
        assert "equivalent within 3 % in all 2 tests" in compare(tmp_path)
    assert not any("unreadable" in outcome for outcome in Catalogue(lab).counts())


def overwritten(path: Path, page: int) -> None:
    with open(path, "r+b") as file:
        file.seek(4096 * page)
        file.write(np.random.default_rng(page).bytes(4096))


@pytest.mark.slow
def test_whatever_page_of_the_index_is_damaged_it_is_put_aside_and_made_again(sound, right, place):
    lab, asked = place / "lab", study_file(place, RECORDED, AT_REST, **SMALL)
    for suffix in ("-wal", "-shm"):
        (lab / f"catalogue.db{suffix}").unlink(missing_ok=True)
    index = (lab / "catalogue.db").read_bytes()
    pages, told = len(index) // 4096, 0
    assert pages > 8
    for page in range(pages):
        shutil.rmtree(lab)
        shutil.copytree(sound / "lab", lab)
        overwritten(lab / "catalogue.db", page)
        for words in (("status",), ("runs",), ("fit", asked, "--backend", "toy"), ("plan", asked, "--backend", "toy")):
            ended = labbook(*words, "--lab", lab, check=False)
            if ended.exit_code:
                told += 1
                assert "make it again: labbook reindex" in ended.output, (page, words, ended.output)
                assert len(ended.output.strip().splitlines()) == 1
        ended = labbook("reindex", "--lab", lab)
        assert "2 runs and 2 packings indexed" in ended.output
        assert "kept as catalogue.db.damaged" in ended.output, f"page {page}"
        assert (lab / "catalogue.db.damaged").exists()
        assert numbers(lab) == right
    assert told > pages, "or the pages would not matter"


def test_run_makes_a_damaged_index_again_itself(right, place):
    lab = place / "lab"
    overwritten(lab / "catalogue.db", 0)
    ended = labbook("run", study_file(place, RECORDED, AT_REST, **SMALL), "--lab", lab, "--backend", "toy")
    assert "2 of 2 runs done" in ended.output
    assert "kept as catalogue.db.damaged" in " ".join(ended.output.split())
    assert numbers(lab) == right


def test_an_index_that_is_no_file_is_put_aside_too(right, place):
    lab = place / "lab"
    for suffix in ("", "-wal", "-shm"):
        (lab / f"catalogue.db{suffix}").unlink(missing_ok=True)
    (lab / "catalogue.db").mkdir()
    assert "labbook reindex" in labbook("status", "--lab", lab, check=False).output
    labbook("reindex", "--lab", lab)
    assert numbers(lab) == right
