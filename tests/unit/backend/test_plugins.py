"""A package from outside adds a law, a wall, a start, a measure, a fit, a paper and a backend, of which nothing in
labbook knows."""

import json
import math
import os
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from scipy.integrate import quad
from toy_lab import ROOT, study_file

from labbook import plugins
from labbook.cli.options import explanation
from labbook.fit import LAWS, Law
from labbook.lab.folder import PICTURE
from labbook.papers import Paper
from labbook.plugins import BrokenPlugin, Registry

OUTSIDE = ROOT / "tests/toy/outside"


def run_outside(*words: object) -> subprocess.CompletedProcess[str]:
    """`python WORDS` in a process that has the package installed."""
    folders = [OUTSIDE, ROOT, ROOT / "backends", ROOT / "tests/toy"]
    given = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders))}
    return subprocess.run([sys.executable, *map(str, words)], env=given, capture_output=True, text=True)


def labbook(*words: object) -> subprocess.CompletedProcess[str]:
    """`labbook WORDS` in such a process."""
    return run_outside("-c", "from labbook.cli import main; main()", *words)


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("outside")
    more = (
        "fit: [straight, beverloo, drain]",
        "reference:",
        "  source: a paper",
        "  half_time: {value: 200 ms}",
        "  straight.c: {value: 3 mm}",
        "  drain.p: {value: 2.5}",
        "  drained.first: {value: 300 ms}",
        "  drained.order: {from: 0.9, says: wide silos drain fast}",
    )
    path = study_file(folder, *more, orifices="[15, 18, 21, 24]")
    path.write_text(path.read_text().replace("[flow_rate]", "[flow_rate, half_time]"))
    return path


@pytest.mark.slow
def test_they_go_through_every_verb(study):
    there = ("--lab", study.parent / "lab", "--backend", "hourglass")
    for verb in (("run",), ("report",), ("export",)):
        ended = labbook(*verb, study, *there)
        assert ended.returncode == 0, ended.stderr
    found = json.loads(labbook("fit", study, *there, "--json").stdout)
    halves = [row["value"] for row in found["points"] if row["quantity"] == "half_time"]
    assert halves == sorted(halves, reverse=True)
    assert len(halves) == 4
    fitted = {(row["law"], row["parameter"]) for row in found["fits"]}
    assert {("straight", "S"), ("straight", "c"), ("beverloo", "k"), ("drain", "p")} <= fitted
    for record in (study.parent / "lab/runs").glob("*/run.json"):  # says which package made its physics
        assert json.loads(record.read_text())["sessions"][-1]["provenance"]["packages"]["silo-extras"] == "1"
    ours = {row["quantity"]: row["ours"] for row in found["reference"]}
    assert set(ours) == {"half_time", "straight.c", "drain.p", "drained.first"}
    assert None not in ours.values()
    assert ours["drained.first"] == pytest.approx(halves[0])
    (stated,) = found["statements"]
    assert (stated["quantity"], stated["ours"], stated["verdict"]) == ("drained.order", 1, "holds")
    assert [row["half_time"] for row in found["drained"]] == pytest.approx(halves)
    shown = labbook("fit", study, *there).stdout
    for text in ("t½", "S [g/(s mm)]", "Drain", "t½ of the first [ms]", "wide silos drain fast", "Ends are those"):
        assert text in shown
    folder = study.parent / "lab/reports/toy-study"
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "W = S (D - c)" in page or "straight" in page.lower()
    for text in ("t½", "How silos drain", "These drain."):
        assert text in page
    assert (folder / "drain.svg").is_file()
    assert (study.parent / "lab/exports/toy-study/drained.csv").is_file()


WALLS = """container:
  kind: primitives
  outlet_plane: 0 mm
  parts:
    - {name: front, shape: {kind: plane, point: [0 mm, -5 mm, 0 mm], normal: [0, 1, 0]}}
    - {name: back, shape: {kind: plane, point: [0 mm, 5 mm, 0 mm], normal: [0, -1, 0]}}
    - {name: left, shape: {kind: strip, start: [-30 mm, 0 mm], end: [-30 mm, 300 mm]}}
    - {name: right, shape: {kind: strip, start: [30 mm, 0 mm], end: [30 mm, 300 mm]}}
    - {name: floor-left, shape: {kind: strip, start: [-30 mm, 0 mm], end: [-12 mm, 0 mm]}}
    - {name: floor-right, shape: {kind: strip, start: [12 mm, 0 mm], end: [30 mm, 0 mm]}}
    - {name: lid, opens: start, shape: {kind: strip, start: [-12 mm, 0 mm], end: [12 mm, 0 mm]}}
    - {name: obstacle, shape: {kind: ball, centre: [0 mm, 0 mm, 30 mm], radius: 8 mm}}
"""


@pytest.mark.parametrize(
    "backend",
    [
        pytest.param("hourglass", marks=pytest.mark.slow),
        pytest.param("numba", marks=[pytest.mark.compiles, pytest.mark.ring]),
    ],
)
def test_a_wall_from_outside_in_a_silo_is_filled_drawn_recorded_and_measured(tmp_path, backend):
    path = study_file(tmp_path, "record: {every: 20 ms, replicates: 1}", replicates=1, count=250)
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    skipped = ("container:", "sweep:", "  container.orifice")
    text = "".join(line for line in lines if not line.startswith(skipped)) + WALLS
    text = text.replace("[flow_rate]", "[flow_rate, half_time]")
    path.write_text(text if backend == "hourglass" else text.replace("dt: 10 us, ", ""), encoding="utf-8")
    there = ("--lab", tmp_path / "lab", "--backend", backend)
    ended = labbook("run", path, *there)
    assert ended.returncode == 0, ended.stderr
    found = json.loads(labbook("fit", path, *there, "--json").stdout)
    rates = [row["value"] for row in found["points"] if row["quantity"] == "flow_rate"]
    assert len(rates) == 1
    assert rates[0] > 0
    (run,) = (tmp_path / "lab/runs").glob("*/run.json")
    assert (run.parent / PICTURE).is_file()
    ended = run_outside("-c", RECORDED, run.parent, tmp_path / "lab")
    assert ended.returncode == 0, ended.stderr
    recorded = json.loads(ended.stdout)
    assert recorded["holds"]
    assert recorded["walls"]["obstacle"] == 8, "an octahedron, as its package draws it"
    assert set(recorded["walls"]) > {"front", "back", "left", "right", "floor-left", "floor-right"}


RECORDED = """
import json, sys
from pathlib import Path
from rerun.chunk import RrdReader
from labbook.export.recording import of_run
path = of_run(Path(sys.argv[1]), Path(sys.argv[2]))
assert RrdReader(path).recordings()
from labbook.lab.runs import open_run
from labbook.export.wall_shapes import drawn_walls
record, run = open_run(Path(sys.argv[1]))
walls = {wall.name: len(wall.mesh.triangles) for wall in drawn_walls(run.scene, run.start.x)}
print(json.dumps({"walls": walls, "holds": b"walls/obstacle" in path.read_bytes()}))
"""


@pytest.mark.slow
def test_what_a_paper_cannot_compare_is_told_in_its_words(study):
    wrong = study.with_name("wrong.yaml")
    text = study.read_text(encoding="utf-8")
    wrong.write_text(text.replace("{from: 0.9, says: wide silos drain fast}", "{value: 1}"), encoding="utf-8")
    ended = labbook("plan", wrong, "--lab", study.parent / "none", "--backend", "hourglass")
    assert ended.returncode == 1
    assert "an order is no number" in ended.stderr
    assert "write `from`, `to` and `says`" in ended.stderr


@pytest.mark.slow
def test_without_the_package_the_study_says_what_is_not_known(study):
    words = ("-c", "from labbook.cli import main; main()", "plan", str(study), "--lab", str(study.parent / "none"))
    ended = subprocess.run([sys.executable, *words], capture_output=True, text=True)
    assert ended.returncode == 1
    for name in ("half_time", "straight", "no law is called drain"):
        assert name in ended.stderr


@pytest.mark.parametrize(
    ("value", "why"),
    [
        ("silo_nothing:Law", "cannot be loaded (ModuleNotFoundError"),
        ("labbook.fit:fit", "it is not a Law"),
        ("labbook.fit:Power", "another package provides power"),
    ],
)
def test_what_is_broken_is_named_with_a_remedy(monkeypatch, value, why):
    entry, laws = EntryPoint("power", value, "labbook.laws"), tuple(LAWS.values())
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry] if group == "labbook.laws" else [])
    registry = Registry[Law]("labbook.laws", Law, laws)
    with pytest.raises(BrokenPlugin, match="uninstall") as raised:
        dict(registry)
    assert why in str(raised.value)
    assert value in str(raised.value)
    assert explanation(raised.value) == str(raised.value), "every verb ends with this line"


MASS = 2500 * math.pi / 6 * 0.003**3
"""Of the spheres of outside/bounce.py [kg]; its rods, 4 d long, weigh 5.5 times as much."""


@pytest.mark.parametrize(
    "backend",
    [
        pytest.param("reference", marks=pytest.mark.slow),
        pytest.param("warp", marks=[pytest.mark.compiles, pytest.mark.ring]),
        pytest.param("numba", marks=[pytest.mark.compiles, pytest.mark.ring]),
    ],
)
def test_bodies_bounce_off_a_wall_from_outside_by_a_law_from_outside(backend):
    """Elastically: a sphere and a rod that lies across go back as fast as they came, after the time that an integral
    gives; a rod that is met beside its middle keeps its energy, and turns."""
    ended = run_outside(OUTSIDE / "bounce.py", backend)
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout.splitlines()[-1])
    assert found["triangles"] == 8, "recordings show it"
    for body, mass in (("sphere", MASS), ("rod", 5.5 * MASS)):
        one = found[body]
        assert one["v"] == pytest.approx([0.0, 0.0, 0.5], abs=1e-7)
        assert one["omega"] == pytest.approx([0.0] * 3, abs=1e-6)
        deepest = (1.5 * mass * 0.5**2 / 1e9) ** (1 / 3)
        whole, _ = quad(lambda u: 1 / math.sqrt(1 - u**3), 0, 1)
        assert one["steps"] == pytest.approx(2 * deepest / 0.5 * whole / 5e-7, abs=2)
    r, length = 1.5e-3, 9e-3  # of the cylinder, with two half spheres at its ends
    cylinder, ends = 4.5 * MASS, MASS
    inertia = cylinder * (length**2 / 12 + r**2 / 4) + ends * (0.4 * r**2 + length**2 / 4 + 3 * length * r / 8)
    beside = found["beside"]
    energy = 5.5 * MASS * sum(v**2 for v in beside["v"]) + inertia * beside["omega"][1] ** 2
    assert energy == pytest.approx(5.5 * MASS * 0.5**2, rel=1e-6)
    assert beside["omega"][1] > 50


STUDY = """
name: outside
grains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 5}
contact: {law: quadratic, stiffness: 1 GPa}
container:
  kind: primitives
  parts:
    - {name: floor, shape: {kind: plane, point: [0 mm, 0 mm, 0 mm], normal: [0, 0, 1]}}
    - {name: stone, shape: {kind: ball, centre: [0 mm, 0 mm, 0 mm], radius: 2 mm}}
fill: {kind: stack}
measure: []
"""


@pytest.mark.slow
def test_a_study_names_a_law_a_wall_and_a_start_from_outside(tmp_path):
    study = tmp_path / "outside.yaml"
    study.write_text(STUDY, encoding="utf-8")
    there = ("--lab", tmp_path / "lab", "--backend", "reference")
    ended = labbook("plan", study, *there)
    assert ended.returncode == 0, ended.stderr
    for wrong, keys in (
        (("1 GPa", "1 mm"), ("contact.stiffness", "100 MPa")),
        (("radius: 2 mm", "size: 2 mm"), ("size",)),
        (("1 GPa}", "1 GPa, damping: printed}"), ("contact.damping", "law quadratic has no use for damping")),
    ):
        study.write_text(STUDY.replace(*wrong), encoding="utf-8")
        ended = labbook("plan", study, *there)
        assert ended.returncode == 1
        assert all(key in ended.stderr for key in keys)
    misspelt = STUDY.replace("law: quadratic", "law: cubic").replace("kind: stack", "kind: heap")
    study.write_text(misspelt, encoding="utf-8")
    ended = labbook("plan", study, *there)
    assert ended.returncode == 1
    assert {"quadratic", "stack"} <= set(ended.stderr.replace(",", " ").split()), "names that there are, are listed"


def test_a_paper_that_lists_a_fit_which_it_cannot_make_is_told_where_it_is_defined():
    with pytest.raises(TypeError, match=r"Half lists drain in `fits` and has no method `fit`; add `def fit"):
        type("Half", (Paper,), {"name": "half", "fits": {"drain": "half_time"}})
    whole = type("Whole", (Paper,), {"name": "whole", "fits": {"drain": "half_time"}, "fit": lambda *_: None})
    assert type("Narrower", (whole,), {"name": "narrower"}).fits == whole.fits
