"""Recipes of docs/howto.md, run line by line: on the toy backend, with fewer grains."""

import json
import math
import re
import shlex
from pathlib import Path

import pytest
from toy_lab import WINDOW, labbook, study_file

from labbook.study import load

ROOT = Path(__file__).parents[3]
NUMERICS = "numerics: {dt: 10 us, steps_per_beat: 200, precision: double}\n"


def recipe(title: str) -> list[list[str]]:
    """Words of each `labbook` line in the section of this title, without the comment at its end."""
    text = (ROOT / "docs/howto.md").read_text(encoding="utf-8")
    section = re.split(r"^## ", text.split(f"## {title}\n")[1], flags=re.MULTILINE)[0]
    lines = [line for block in re.findall(r"```sh\n(.*?)```", section, re.DOTALL) for line in block.splitlines()]
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("labbook ")]


@pytest.mark.slow
def test_recipes_of_mixtures_and_residence_give_what_they_promise(tmp_path, monkeypatch):
    """The second continues the first, with the same study."""
    commands = [*recipe("Follow the kinds of a mixture"), *recipe("See from where grains leave first")]
    (tmp_path / "studies").mkdir()
    for study in {words[1] for words in commands}:
        text = (ROOT / study).read_text(encoding="utf-8").replace("replicates: 3", "replicates: 1") + NUMERICS
        (tmp_path / study).write_text(re.sub(r"count: \d+", "count: 800", text), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for words in commands:
        labbook(*words, "--backend", "toy")
    report, tables = tmp_path / "lab/reports/mixture-cone", tmp_path / "residence"
    promised = [report / "composition.png", report / "residence-map.png", tmp_path / "mixture/composition.csv"]
    promised += [tables / "residence.csv", tables / "layers.csv"]
    assert [path for path in promised if not path.exists()] == []
    page = (report / "report.html").read_text(encoding="utf-8")
    for words in ("Composition of the outflow", "mass in the bed [%]", "Residence times", "first in, first out"):
        assert words in page


def test_a_hopper_from_a_file_is_planned_as_its_recipe_says(tmp_path, monkeypatch):
    pytest.importorskip("trimesh")
    pytest.importorskip("numba")
    text = (ROOT / "docs/howto.md").read_text(encoding="utf-8").split("## Use a hopper from an STL file\n")[1]
    (tmp_path / "my-hopper.yaml").write_text(text.split("```yaml\n")[1].split("```")[0], encoding="utf-8")
    corners = [
        (s * x, s * y, z) for s, z in ((6, 0), (20, 25), (20, 120)) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    facets = []
    for ring in (0, 4):
        for k in range(4):
            a, b = ring + k, ring + (k + 1) % 4
            for t in ((a, b, b + 4), (a, b + 4, a + 4)):
                places = "\n".join("vertex {} {} {}".format(*corners[n]) for n in t)
                facets.append(f"facet normal 0 0 0\nouter loop\n{places}\nendloop\nendfacet")
    (tmp_path / "hopper.stl").write_text("solid h\n" + "\n".join(facets) + "\nendsolid h\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    plan, *_ = recipe("Use a hopper from an STL file")
    shown = " ".join(labbook(*plan).output.split())
    slant = (25**2 + 14**2) ** 0.5
    area = (4 * (12 + 40) / 2 * slant + 4 * 40 * 95) / 100
    assert f"Mesh hopper: 16 triangles, not closed, area {area:.4g} cm^2, 40 x 40 x 120 mm" in shown
    assert "Warning: my-hopper.yaml: container.outlet_plane" not in shown


@pytest.mark.slow
def test_measured_flow_rates_stand_beside_ours(tmp_path, monkeypatch):
    """The CSV of the recipe, beside the study that it names: the outlet of 17 mm, which is not simulated, counts in the
    measurement's own C and k."""
    section = (ROOT / "docs/howto.md").read_text(encoding="utf-8").split("## Compare with an experiment\n")[1]
    table, line = section.split("```text\n")[1].split("```")[0], section.split("```yaml\n")[1].split("```")[0]
    (tmp_path / "experiment.csv").write_text(table)
    path = study_file(tmp_path, line, "fit: [beverloo]", orifices="[18, 22, 26, 30]", count=160)
    monkeypatch.chdir(tmp_path)
    labbook("run", path, "--backend", "toy")
    shown = labbook("fit", path, "--backend", "toy").output
    assert "Beside Own measurement" in shown
    for words in ("16.8", "28.9", "53.0"):
        assert words in shown
    plain = json.loads(labbook("fit", path, "--backend", "toy", "--json").stdout)
    outlets = {row.get("container.orifice") for row in plain["reference"]}
    assert {0.017, 0.018, 0.022, 0.026, 0.03} <= outlets


@pytest.mark.slow
def test_a_design_is_chosen_from_a_sweep_of_two_keys(tmp_path, monkeypatch):
    """With fewer points, grains and seeds; the target is in the range of the toy."""
    commands = recipe("Choose a design from a sweep of several keys")
    (tmp_path / "studies").mkdir()
    text = (ROOT / "studies/hopper-angle.yaml").read_text(encoding="utf-8") + NUMERICS
    text = text.replace("[15, 30, 60, 90]", "[30, 60]").replace("[18, 21, 24, 28, 32]", "[18, 24, 32]")
    text = text.replace("count: 1000", "count: 400").replace("replicates: 3", "replicates: 2")
    (tmp_path / "studies/hopper-angle.yaml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    _, want, explore, site = [labbook(*words, *([] if words[0] == "site" else ["--backend", "toy"])).output
                              for words in commands]  # fmt: skip
    assert re.search(r"D = [\d.]+ mm \(95 %: .* gives W = 40", want)
    assert "angle = 45 deg" in want
    for words in ("What matters", "What to run next", "name: hopper-angle-next"):
        assert words in explore
    assert "hopper/index.html" in site.replace("\n", "")
    assert (tmp_path / "hopper/study/hopper-angle/explore.html").is_file()


@pytest.fixture
def rods_and_spheres(tmp_path):
    """The study of the recipe, with fewer grains and seeds."""
    text = (ROOT / "docs/howto.md").read_text(encoding="utf-8").split("## Compare rods with spheres\n")[1]
    quick = text.split("```yaml\n")[1].split("```")[0].replace("count: 700", "count: 200")
    path = tmp_path / "rods-and-spheres.yaml"
    path.write_text(quick.replace("replicates: 3", "replicates: 1") + NUMERICS + WINDOW, encoding="utf-8")
    return path


def test_rods_and_spheres_of_a_recipe_have_one_volume(rods_and_spheres):
    sphere, rod = (point.scene.grains for point in load(rods_and_spheres).points)
    assert rod.mass == pytest.approx(sphere.mass, rel=1e-4)
    assert sphere.mass == pytest.approx(2500 * math.pi / 6 * 0.0040716**3, rel=1e-3)
    d, length = 0.003, 0.006  # the formula of the recipe for other lengths
    volume = sphere.mass / 2500
    assert (4 * volume / math.pi) ** (1 / 3) * (length / d - 1 / 3) ** (-1 / 3) == pytest.approx(d, rel=1e-4)


@pytest.mark.ring
@pytest.mark.slow
def test_rods_and_spheres_of_a_recipe_both_have_a_flow_rate(rods_and_spheres, monkeypatch):
    monkeypatch.chdir(rods_and_spheres.parent)
    run, fit, report = recipe("Compare rods with spheres")
    labbook(*run, "--backend", "toy")
    told = labbook(*fit, "--backend", "toy", "--json").stdout
    rows = [row for row in json.loads(told)["points"] if row["quantity"] == "flow_rate"]
    assert [(row["grains.diameter"], row["grains.length"]) for row in rows] == [(0.0040716, 0.0040716), (0.003, 0.006)]
    assert all(row["value"] > 0 for row in rows)
    labbook(*report, "--backend", "toy")


@pytest.mark.slow
def test_two_outlets_open_at_the_start(tmp_path, monkeypatch):
    (command,) = recipe("Two outlets or an insert")
    (tmp_path / "studies").mkdir()
    text = re.sub(r"count: \d+", "count: 200", (ROOT / command[1]).read_text(encoding="utf-8"))
    (tmp_path / command[1]).write_text(re.sub(r"replicates: \d+", "replicates: 1", text) + NUMERICS, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    labbook(*command, "--backend", "toy")
    rows = json.loads(labbook("runs", "--json").stdout)
    assert {row["outcome"] for row in rows} <= {"finished", "emptied"}
    study = load(tmp_path / command[1])
    assert "outlets" in study.measure
    lids = [part.name for part in study.points[0].scene.container.parts if part.opens == "start"]
    assert sorted(lids) == ["lid-left", "lid-right"]


def test_the_wall_of_the_recipe_moves_up_and_is_measured():
    """Its run is a test of `wall_stress`; here the study is what the recipe says of it."""
    (command, *_) = recipe("Pressure on the wall of a silo")
    study = load(ROOT / command[1])
    assert "wall_stress" in study.measure
    scene = study.points[0].scene
    assert scene.container.outlet_plane is None
    (side,) = [wall for wall in scene.container.walls() if wall.name == "side"]
    assert side.motion.velocity == pytest.approx((0, 0, 2e-3))
