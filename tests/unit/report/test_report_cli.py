"""`labbook fit`, `report` and `view`, from a study file to what they print and write, on the toy backend."""

import importlib
import json
import re
import shutil
from pathlib import Path

import pytest

TOY = Path(__file__).parents[2] / "toy"


@pytest.fixture(scope="module")
def toy():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(TOY)
        yield importlib.import_module("toy_lab")


@pytest.fixture(scope="module")
def done(toy, tmp_path_factory):
    """A study that was carried out: its file, its lab, and what to add to a command to speak of them."""
    folder = tmp_path_factory.mktemp("done")
    lines = ("fit: [beverloo]", "record: {every: 20 ms, replicates: 1}")
    study = toy.study_file(folder, *lines, orifices="[18, 24, 30, 36]")
    lab = folder / "lab"
    toy.labbook("run", study, "--lab", lab, "--backend", "toy")
    return study, lab, ("--lab", lab, "--backend", "toy")


def test_fit_prints_tables_and_json(toy, done):
    study, _, where = done
    shown = toy.labbook("fit", study, *where).stdout
    assert "Flow rates" in shown
    assert "C (grain density)" in shown
    found = json.loads(toy.labbook("fit", study, "--json", *where).stdout)
    flows = [row for row in found["points"] if row["quantity"] == "flow_rate"]
    assert [row["container.orifice"] for row in flows] == [0.018, 0.024, 0.03, 0.036]
    assert {row["replicates"] for row in flows} == {2}
    assert {row["parameter"] for row in found["fits"] if row["law"] == "beverloo"} == {"C_particle", "k", "slope"}


@pytest.mark.slow
@pytest.mark.usefixtures("one_format")
def test_report_is_written_below_the_lab_or_where_asked(toy, done, tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1770076800")  # both on one day, also about midnight
    study, lab, where = done
    assert "report.html" in toy.labbook("report", study, *where).stdout
    assert (lab / "reports/toy-study/report.html").is_file()
    toy.labbook("report", study, "--out", tmp_path / "here", *where)
    here, there = tmp_path / "here/report.html", lab / "reports/toy-study/report.html"
    assert here.read_bytes() == there.read_bytes()
    assert "name: toy-study" in here.read_text(encoding="utf-8")


def recordings(lab):
    """Recordings of a lab, with the times when they were written."""
    return {path: path.stat().st_mtime_ns for path in (lab / "recordings").rglob("*.*")}


def test_view_makes_what_is_missing_once_and_names_it_by_point_and_seed(toy, done):
    pytest.importorskip("rerun")
    study, lab, where = done
    toy.labbook("view", study, "--no-open", *where)
    made = recordings(lab)
    folder = lab / "recordings/toy-study"
    assert set(made) == {
        folder / f"point-{n}-seed-1-toy.rrd" for n in (1, 2, 3, 4)
    }  # one replicate of each is recorded
    toy.labbook("view", study, "--no-open", *where)
    assert recordings(lab) == made


def test_view_of_a_run_by_its_key_is_the_same_recording(toy, done):
    pytest.importorskip("rerun")
    study, lab, where = done
    toy.labbook("view", study, "--no-open", *where)
    made = recordings(lab)
    records = (json.loads((folder / "run.json").read_text()) for folder in (lab / "runs").iterdir())
    key = next(one["run_key"] for one in records if (one["point"], one["seed"]) == (2, 1))
    assert "toy-study/point-3-seed-1-toy.rrd" in toy.labbook("view", key[:12], "--no-open", "--lab", lab).stdout
    assert recordings(lab) == made


def test_a_recording_of_another_run_with_the_same_name_is_replaced(toy, done, tmp_path):
    """The points of a study change places: what is shown is the run that now has the name, not what was there."""
    rrd = pytest.importorskip("rerun.chunk")
    study, lab, where = done
    toy.labbook("view", study, "--no-open", *where)
    first, last = (lab / f"recordings/toy-study/point-{n}-seed-1-toy.rrd" for n in (1, 4))
    identity = {path: rrd.RrdReader(path).recordings()[0].recording_id for path in (first, last)}
    turned = tmp_path / "toy.yaml"
    turned.write_text(study.read_text().replace("[18, 24, 30, 36]", "[36, 30, 24, 18]"))
    toy.labbook("view", turned, "--no-open", *where)
    now = {path: rrd.RrdReader(path).recordings()[0].recording_id for path in (first, last)}
    assert now == {first: identity[last], last: identity[first]}
    assert identity[first] != identity[last]
    last.write_bytes(b"no recording")
    toy.labbook("view", turned, "--no-open", *where)
    assert rrd.RrdReader(last).recordings()[0].recording_id == now[last]


def test_damaged_frames_are_named_with_a_remedy(toy, done, tmp_path):
    pytest.importorskip("rerun")
    study, lab, _ = done
    damaged = tmp_path / "lab"
    shutil.copytree(lab, damaged)
    shutil.rmtree(damaged / "recordings", ignore_errors=True)
    frames = sorted(damaged.glob("runs/*/recording.npz"))
    for path in frames:
        path.write_bytes(path.read_bytes()[:100])
    said = toy.labbook("view", study, "--no-open", "--lab", damaged, "--backend", "toy", check=False)
    assert said.exit_code == 1
    assert "recording.npz" in said.output
    assert "make them again: labbook run" in " ".join(said.output.split())


@pytest.mark.slow
def test_films_of_a_study_of_a_run_and_of_its_sweep(toy, done, tmp_path):
    from PIL import Image

    study, lab, where = done
    short = ("--seconds", 0.2, "--size", 60)
    said = toy.labbook("movie", study, *short, *where).stdout
    written = sorted((lab / "films/toy-study").iterdir())
    assert [path.name for path in written] == [f"point-{k}-seed-1-toy-layers.webp" for k in range(1, 5)]
    assert said.count("Film: ") == 4
    key = next(lab.glob("runs/*/recording.npz")).parent.name
    toy.labbook("movie", key[:12], *short, "--colour", "speed", "--out", tmp_path / "one.gif", "--lab", lab)
    toy.labbook("movie", study, *short, "--grid", "--out", tmp_path / "sweep.webp", *where)
    one, sweep = (Image.open(tmp_path / name) for name in ("one.gif", "sweep.webp"))
    assert sweep.width > 4 * 60  # four outlets beside one another
    assert one.height > 60
    for words, remedy in (
        ((study, "--out", tmp_path / "a.gif"), "choose one with --point"),
        ((study, "--colour", "orientation"), "spheres have no orientation"),
        ((key[:12], "--grid"), "no study file"),
    ):
        refused = toy.labbook("movie", *words, *short, *where, check=False)
        assert refused.exit_code == 1
        assert remedy in refused.output


def test_view_of_one_point(toy, done):
    pytest.importorskip("rerun")
    study, _, where = done
    assert toy.labbook("view", study, "--point", 2, "--no-open", *where).stdout.count("Recording:") == 1


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (("fit", "no-such.yaml"), "no-such.yaml"),
        (("fit", "{study}", "--lab", "{empty}"), "labbook run"),
        (("report", "{study}", "--lab", "{empty}"), "labbook run"),
        (("view", "{study}", "--lab", "{empty}"), "labbook run"),
        (("view", "0123456789", "--lab", "{lab}"), "labbook runs"),
        (("view", "{study}", "--point", "9", "--lab", "{lab}", "--backend", "toy"), "has 4 points; use 1 to 4"),
    ],
)
def test_what_is_not_there_is_an_error_with_its_remedy(toy, done, tmp_path, words, remedy):
    study, lab, _ = done
    filled = [word.format(study=study, lab=lab, empty=tmp_path / "empty") for word in words]
    ended = toy.labbook(*filled, check=False)
    assert ended.exit_code == 1
    assert remedy in ended.stderr


def printed(cells: list[str], text: frozenset[int], width: int) -> str:
    """A table of one row."""
    from io import StringIO

    from rich.console import Console

    from labbook.cli.screen import print_table
    from labbook.report.tables import Table

    out, headings = StringIO(), tuple("abcdefg"[: len(cells)])
    print_table(Console(file=out, width=width), Table(headings, (tuple(cells),), text), "numbers")
    return out.getvalue()


@pytest.mark.parametrize("width", [60, 80, 200])
def test_no_number_of_a_table_is_cut_off(width):
    cells = [f"0.{k}2967 ± 0.{k}0045" for k in range(1, 6)]
    shown = printed(cells, frozenset(), width)
    assert "…" not in shown
    assert all(word in shown for cell in cells for word in cell.split())


@pytest.mark.parametrize("width", [60, 80, 94, 120])
def test_text_beside_numbers_wraps_between_words_only(width):
    """And numbers, be they as unlike as these."""
    cells = ["dt = 2.5 µs instead of 5 µs", "12", *(f"{10**k}.2967 ± 0.0045" for k in range(3)), "equivalent, surely"]
    shown = printed(cells, frozenset({0, 5}), width)
    assert all(word in shown for cell in cells for word in cell.split())


def test_long_texts_share_the_room_that_short_ones_leave():
    shown = printed(["one " * 20, "two " * 20, "at 1 of 4"], frozenset({0, 1, 2}), 100).splitlines()
    assert "at 1 of 4" in "".join(shown)
    for word in ("one", "two"):
        assert sum(word in line for line in shown) == 2, "80 characters each, in columns of some 40"


@pytest.mark.slow
def test_runs_are_shown_side_by_side_in_one_recording(toy, done, tmp_path):
    """Names of files say which runs they are; a fifth is refused."""
    rrd = pytest.importorskip("rerun.chunk")
    _, lab, where = done
    keys = sorted(path.parent.name for path in lab.glob("runs/*/recording.npz"))
    said = toy.labbook("view", keys[0][:12], keys[1][:12], "--no-open", *where)
    (path,) = (lab / "recordings/side-by-side").glob("*.rrd")
    assert str(path) in "".join(said.output.split())
    assert re.fullmatch(r"toy-study-point-\d-seed-1-toy_toy-study-point-\d-seed-1-toy\.rrd", path.name)
    entities = {chunk.entity_path for chunk in rrd.RrdReader(path).stream()}
    assert {"/run-1/grains", "/run-2/grains", "/run-1/flow_rate", "/run-2/flow_rate"} <= entities
    refused = toy.labbook("view", *[keys[0]] * 5, "--no-open", *where, check=False)
    assert (refused.exit_code, "at most 4" in refused.output) == (1, True)
