"""The studies that ship, the one that `labbook new` writes, and the page about studies."""

import math
import re
from pathlib import Path

import pytest
import typer
from labbook_toy import Backend
from toy_lab import labbook
from typer.testing import CliRunner

from labbook.cli import new
from labbook.lab import Catalogue, identity
from labbook.plan.advice import advice
from labbook.plan.plan import Planner
from labbook.scene import ConicalSilo, CylinderSilo, LinearSpringDashpot, Spherocylinders
from labbook.scene.contact import Hertz
from labbook.scene.timescales import collision
from labbook.study import StudyError, load, page
from labbook.study.keys import all_keys
from labbook.study.schema import OTHER_KEYS, TOP_KEYS
from labbook.study.template import KINDS, NotWritten, write

ROOT = Path(__file__).parents[3]
STUDIES = ROOT / "studies"
PAGE = (ROOT / "docs" / "studies.md").read_text(encoding="utf-8")


def values(study, key: str) -> set:
    return {round(point.at[key] * 1e3, 6) for point in study.points if key in point.at}


@pytest.mark.parametrize("file", sorted(STUDIES.glob("*.yaml")), ids=lambda file: file.stem)
def test_studies_load_under_their_own_name(file):
    assert load(file).name == file.stem


@pytest.mark.parametrize("name", ["flat-column", "hopper-angle", "eccentricity"])
def test_fan_studies_have_the_parameters_of_table_1(name):
    study = load(STUDIES / f"fan2023-{name}.yaml")
    assert study.replicates == 3
    for point in study.points:
        grains, contact, hopper = point.scene.grains, point.scene.contact, point.scene.container
        assert (grains.diameter, grains.density) == (0.003, 2500.0)
        assert contact.model_dump(exclude={"damping", "rolling", "tangential_damping", "tension"}) == {
            "law": "hertz-printed",
            "shear_modulus": 1e8,
            "poisson_ratio": 0.25,
            "friction": 0.5,
            "rolling_friction": 0.01,
            "restitution": 0.2,
        }
        assert point.scene.walls == {}
        assert (hopper.height, hopper.thickness) == (0.4, 0.00303)  # pyright: ignore[reportAttributeAccessIssue]
        assert point.numerics.dt <= 2.6e-6


def test_dosta_studies_have_the_parameters_of_the_paper():
    """E* and G* of the contacts as MercuryDPM's and YADE's scripts of the benchmark have them; its beds are shared."""
    study, laws = load(STUDIES / "dosta2024-silo.yaml"), load(STUDIES / "dosta2024-laws.yaml")
    seen = set()
    for point in study.points:
        scene, (wall, *_) = point.scene, point.scene.container.walls()
        young, density, restitution, friction, dt = {
            2500.0: (1e9, 2500.0, 0.5, 0.3, 1.5e-6),
            2000.0: (0.5e9, 2000.0, 0.4, 0.4, 2e-6),
        }[scene.grains.density]
        assert (scene.grains.count, scene.grains.diameter, density) == (100_000, 4e-3, scene.grains.density)
        assert (scene.contact.restitution, scene.contact.friction) == (restitution, friction)
        assert point.numerics.dt == dt
        like, steel = scene.contact, scene.law(wall)
        assert (scene.surface(wall).restitution, scene.surface(wall).friction) == (0.4, 0.2)
        for law, other in ((like, young), (steel, 210e9)):
            assert isinstance(law, Hertz)
            assert law.effective_modulus == pytest.approx(1 / (0.96 / young + 0.96 / other), rel=1e-12)
            shear = 1 / (1.8 * 2.4 / young + 1.8 * 2.4 / other)
            kappa = (2 - law.poisson_ratio) / (2 * (1 - law.poisson_ratio))
            assert law.effective_modulus / (4 * kappa) == pytest.approx(shear, rel=1e-12)
        silo = scene.container
        assert isinstance(silo, ConicalSilo)
        assert silo.rise == pytest.approx({0.06: 0.07, 0.04: 0.08}[silo.orifice])
        seen.add((scene.grains.density, silo.orifice))
    assert len(seen) == len(study.points) == 4
    assert (study.window.start, study.window.end, study.window.timed) == (0.5, 3.5, True)
    beds = [
        {identity.scene_key(point.scene.close(point.fill.friction, point.fill.contact)) for point in one.points}
        for one in (study, laws)
    ]
    assert len(beds[1]) == 1
    assert beds[1] < beds[0]


@pytest.mark.parametrize("name", ["rotation-frequency", "orifice", "aspect-ratio", "fields"])
def test_pongo_studies_have_the_parameters_of_the_paper(name):
    study = load(STUDIES / f"pongo2022-{name}.yaml")
    assert study.replicates == 3
    for point in study.points:
        grains, law, silo = point.scene.grains, point.scene.contact, point.scene.container
        assert isinstance(grains, Spherocylinders)
        assert isinstance(law, LinearSpringDashpot)
        assert isinstance(silo, CylinderSilo)
        assert (grains.density, point.scene.gravity, silo.diameter, point.numerics.dt) == (620, 9.8, 0.19, 1e-6)
        assert law.normal_stiffness == pytest.approx(2e5 * grains.mass * 9.8 / grains.diameter, rel=1e-4)
        assert (law.tangential_stiffness, law.tangential_damping, law.damping) == (2 / 7, 1.0, "printed")
        assert (law.friction, law.restitution, law.rolling_friction) == (0.5, 0.9, 0)
        assert grains.length == (0.0099 if grains.diameter == 0.0099 else 0.02)
        assert grains.count == (22_500 if grains.diameter == 0.005 else 10_000)
        assert collision(point.scene) == pytest.approx(1.2e-4, rel=0.4)  # 1.2e-4 s for the rod of 6 mm
    frequencies = {p.at["container.rotation"] for p in study.points}
    assert frequencies == ({0, 0.32, 1.28} if name == "fields" else {0, 0.16, 0.32, 0.64, 0.96, 1.28})


def test_pongo_aspect_ratios_are_compared_at_one_orifice_and_at_one_relative_orifice():
    study, wide = load(STUDIES / "pongo2022-aspect-ratio.yaml"), {}
    for point in study.points:
        grains, silo = point.scene.grains, point.scene.container
        assert isinstance(grains, Spherocylinders)
        assert isinstance(silo, CylinderSilo)
        wide.setdefault(grains.diameter, {})[silo.orifice] = silo.orifice / grains.equivalent_diameter
    assert len(wide) == 4
    for found in wide.values():
        assert 0.06 in found
        assert any(relative == pytest.approx(6.06, rel=2e-3) for relative in found.values())


def test_fan_flat_column():
    study = load(STUDIES / "fan2023-flat-column.yaml")
    assert values(study, "container.orifice") == {18, 21, 24, 30, 36, 45, 52.5, 60}
    assert study.fit == ("beverloo", "janda", "outlet_profiles", "outlet_crossings")
    assert study.points[0].numerics.dt == 2.5e-6
    assert study.reference is not None
    published = {(e.quantity, e.at.get("container.orifice"), e.says): e.value for e in study.reference.entries}
    assert published["beverloo.C", None, ""] == 0.58
    assert published["beverloo.k", None, ""] == 1.55
    assert published["flow_rate", 0.06, "eq 14 as printed"] == pytest.approx(0.1647)
    assert published["flow_rate", 0.06, "line of Fig. 2b"] == pytest.approx(0.1792)


def test_fan_hopper_angle():
    study = load(STUDIES / "fan2023-hopper-angle.yaml")
    angles = {round(math.degrees(float(point.at["container.angle"])), 9) for point in study.points}
    assert angles == {15, 30, 55, 75, 90}
    assert values(study, "container.orifice") == {18, 30, 45, 60}
    assert len(study.points) == 20


def test_fan_eccentricity_lists_all_gaps_that_there_are():
    study = load(STUDIES / "fan2023-eccentricity.yaml")
    listed = set()
    for point in study.points:
        width, orifice = (round(float(point.at[f"container.{key}"]) * 1e3, 6) for key in ("width", "orifice"))
        gap = point.at.get("container.gap")
        listed.add((width, orifice, None if gap is None else round(float(gap) * 1e3, 6)))
        # the bed is as high in both hoppers
        assert point.scene.grains.count == 30 * width
    allowed = {
        (width, orifice, gap)
        for width in (100, 150)
        for orifice in (18, 30, 45, 60)
        for gap in (0, 6, 12, 18, 24, 30, None)
        if gap is None or gap <= (width - orifice) / 2
    }
    assert listed == allowed


def test_quickstart_is_small_and_flows():
    study = load(STUDIES / "quickstart.yaml")
    assert study.record is not None
    assert study.replicates == 3
    assert min(float(p.at["container.orifice"]) / p.scene.grains.diameter for p in study.points) >= 6 - 1e-9
    assert all(p.numerics.dt > 1e-5 for p in study.points)


def app() -> typer.Typer:
    app = typer.Typer()
    app.callback()(lambda: None)
    new.register(app)
    return app


def test_new_writes_a_study_that_loads(tmp_path):
    result = CliRunner().invoke(app(), ["new", "my-silo", "--folder", str(tmp_path)])
    assert result.exit_code == 0, result.output
    path = tmp_path / "my-silo.yaml"
    assert load(path).name == "my-silo"
    assert f"labbook run {path}" in path.read_text()


def test_new_overwrites_nothing(tmp_path):
    path = write("mine", tmp_path)
    path.write_text("precious")
    result = CliRunner().invoke(app(), ["new", "mine", "--folder", str(tmp_path)])
    assert result.exit_code == 1
    assert path.read_text() == "precious"


@pytest.mark.parametrize("name", ["", "two words", "../up", "9lives", "x" * 81])
def test_new_refuses_names(tmp_path, name):
    with pytest.raises(NotWritten, match="letters, digits"):
        write(name, tmp_path)
    assert not list(tmp_path.iterdir())


def test_new_says_when_a_folder_is_missing(tmp_path):
    with pytest.raises(NotWritten, match="cannot be written"):
        write("mine", tmp_path / "nowhere")


def uncommented(text: str) -> str:
    """The template with every setting switched on that it only shows."""
    return re.sub(
        r"^( *)# (?=[a-z]+: \S|  - \{|reference:|points:|  source:|  beverloo)", r"\1", text, flags=re.MULTILINE
    )


@pytest.mark.parametrize("kind", KINDS)
def test_what_the_template_shows_is_right_too(tmp_path, kind):
    path = write("mine", tmp_path, kind)
    plain = load(path)
    listed = re.findall(r"^#   - (\{.*\})$", path.read_text(), flags=re.MULTILINE)
    assert len(listed) == 1
    text = uncommented(path.read_text())
    text = re.sub(r"^points:\n(  - .*\n)+", "", text, flags=re.MULTILINE)  # the sweep has the same key
    accuracy = "accuracy: {flow_rate: 1 %, max_replicates: 10}\n"
    text = text if plain.fit else text.replace(accuracy, "")  # nothing flows there
    path.write_text(text)
    study = load(path)
    assert study.accuracy.flow_rate == (0.01 if plain.fit else None)
    assert study.points[0].scene.walls["all"].friction == 0.1
    assert study.reference is not None
    assert study.window == plain.window
    assert study.stop.discharged == plain.stop.discharged
    if kind not in ("box", "primitives"):  # whose templates have no outlet
        assert (study.stop.stall, study.stop.max_time) == (2.0, 60.0)
    path.write_text(re.sub(r"^sweep:\n(  .*\n)+", f"points: [{listed[0]}]\n", text, flags=re.MULTILINE))
    assert len(load(path).points) == 1


@pytest.mark.parametrize("kind", KINDS)
def test_a_plan_of_the_template_warns_of_nothing(tmp_path, kind):
    """Not even of what is worth a hint in long plans only."""
    path, lab = write("mine", tmp_path, kind), tmp_path / "lab"
    study = load(path)
    shown = labbook("plan", path, "--lab", lab, "--backend", "toy").output
    assert f"{3 * len(study.points)} missing" in shown
    assert "Warning" not in shown
    assert not list(advice(Planner(study, Catalogue(lab), Backend().capabilities).plan()))
    assert study.points[0].scene.container.kind == kind


def test_there_is_a_template_of_every_container(tmp_path):
    (kinds,) = (key.choices for key in all_keys() if key.name == "container.kind")
    assert {*KINDS} == {*kinds}
    told = CliRunner().invoke(app(), ["new", "--help"], env={"COLUMNS": "200"}).output
    assert all(kind in told for kind in KINDS)
    result = CliRunner().invoke(app(), ["new", "mine", "--folder", str(tmp_path), "--kind", "hopper"])
    assert result.exit_code == 1
    assert "use one of wedge-hopper, cylinder-silo" in result.output


def test_the_page_has_exactly_the_keys_that_there_are():
    assert page.with_tables(PAGE) == PAGE, "run: make docs"
    assert sorted(page.sections(PAGE)) == sorted({key.name.partition(".")[0] for key in all_keys()})
    listed = re.findall(r"^\| `([^`]+)`", PAGE, flags=re.MULTILINE)
    tops = {name.partition(".")[0] for name in listed}
    assert tops == set(TOP_KEYS)
    hand_written = {*OTHER_KEYS, "adapt"} - {"fill", "numerics"}
    by_hand = {name for name in listed if name.partition(".")[0] in hand_written}
    assert set(listed) - by_hand == {key.name for key in page.documented_keys()}
    assert {name.partition(".")[0] for name in by_hand} == hand_written


def test_defaults_on_the_page_are_those_of_the_models(tmp_path):
    """A default that is written out changes nothing; where window and run end goes by the bed (test_study_window)."""
    base = PAGE.split("```yaml\n")[1].split("```")[0].replace("name: orifices", "name: base")
    file = tmp_path / "base.yaml"
    file.write_text(base)
    plain = load(file)
    extra = "fill: {kind: rain, settled_below: 1e-6}\ngravity: 9.81 m/s^2\n"
    extra += "numerics: {dt: 0.1 rayleigh, precision: double, integrator: leapfrog, skin: 0.15, steps_per_beat: 1000}\n"
    ends = f"window: {{start: 0.15, end: {plain.window.end}}}\nstop: {{discharged: {plain.stop.discharged}}}\n"
    extra += ends
    file.write_text(base + extra)
    stated = load(file)
    assert [(p.scene, p.fill, p.numerics) for p in plain.points] == [
        (p.scene, p.fill, p.numerics) for p in stated.points
    ]
    assert (plain.window, plain.stop) == (stated.window, stated.stop)


def test_examples_on_the_page_load(tmp_path):
    first, grains, contact, materials, springs, periodic, lip, parts, below, *others = (
        block.split("```")[0] for block in PAGE.split("```yaml\n")[1:]
    )
    file = tmp_path / "orifices.yaml"
    without_sweep = re.sub(r"^sweep:\n(  .*\n)+", "", first, flags=re.MULTILINE).replace("60 mm", "100 mm")
    file.write_text(first)
    assert len(load(file).points) == 3
    counts = []
    for other in others[:3]:
        file.write_text(without_sweep + other)
        counts.append(len(load(file).points))
    assert counts == [20, 2, 2]
    file.write_text(without_sweep + 'sweep: {container.orifice: "[18, 30] mm"}\n' + others[3])
    assert load(file).reference is not None
    rest = [line for line in without_sweep.splitlines() if not line.startswith(("grains:", "contact:"))]
    file.write_text("\n".join(["name: mixture", *rest[1:], grains, contact]))
    (mixture,) = load(file).points
    assert [kind.name for kind in mixture.scene.grains.kinds] == ["glass", "steel"]
    assert mixture.scene.surface_between(0, 1).friction == 0.3
    file.write_text("\n".join(["name: materials", *rest[1:], materials]))
    (mixture,) = load(file).points
    assert mixture.scene.law_between(0, 0) is mixture.scene.contact
    assert mixture.scene.has_own_stiffness
    file.write_text("\n".join(["name: springs", *rest[1:], grains, springs]))
    (sprung,) = load(file).points
    assert sprung.scene.contact.rolling_spring == (2.25, 0.3)
    assert sprung.scene.contact.rolling_model == "epsd"
    plain = "\n".join(line for line in without_sweep.splitlines() if not line.startswith("container:"))
    file.write_text(plain + "\n" + periodic)
    assert load(file).points[0].scene.container.period == pytest.approx(10e-3)
    file.write_text(plain + "\n" + lip)
    (silo,) = load(file).points
    assert silo.scene.sink == pytest.approx(-6e-3)
    file.write_text(plain + "\n" + parts)
    (silo,) = load(file).points
    assert [wall.name for wall in silo.scene.container.close().walls()] == ["floor", "lid"]
    assert [wall.name for wall in silo.scene.container.walls()] == ["floor"]
    file.write_text(plain + "\n" + below)
    (silo,) = load(file).points
    sink, outlet = silo.scene.sink, silo.scene.outlet
    assert sink is not None
    assert outlet is not None
    assert sink < outlet


def test_problems_on_the_page_are_what_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    block = PAGE.split("```yaml\n")[1].split("```")[0]
    told = PAGE.split("```text\n")[1].split("```")[0]
    file = Path("orifices.yaml")
    file.write_text(block.replace("thickness", "thicknes").replace("24, 30", "24, 80"))
    with pytest.raises(StudyError) as caught:
        load(file)
    assert str(caught.value) == told.rstrip()
