"""Studies made and changed in Python: the same as from a file, with the same complaints."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pint
import pytest

import labbook
from labbook.plan.demand import PointDemand
from labbook.scene import Primitives, Scene

ROOT = Path(__file__).parents[3]
STUDIES = sorted((ROOT / "studies").glob("*.yaml"))
OF_THEMSELVES = [path for path in STUDIES if path.stem not in ("blade", "drum", "late-gate")]
"""Those without a file beside them, which a study from Python has not."""
PLAIN = {
    "name": "hopper",
    "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 200},
    "contact": {
        "law": "hertz-mindlin",
        "shear_modulus": "2 MPa",
        "poisson_ratio": 0.25,
        "friction": 0.5,
        "restitution": 0.2,
    },
    "container": {
        "kind": "wedge-hopper",
        "width": "60 mm",
        "height": "300 mm",
        "thickness": "1.01 d",
        "orifice": "24 mm",
    },
    "sweep": {"container.orifice": "[18, 24] mm"},
}


def keys(study: labbook.Study) -> list[str]:
    """Keys of the first runs of every point."""
    return [PointDemand(study, point).run(1).run_key("numba", 1) for point in study.points]


@pytest.fixture(scope="module")
def units():
    """Units that are not labbook's own."""
    return pint.UnitRegistry()


loaded = cache(labbook.load)


@pytest.mark.parametrize("path", OF_THEMSELVES, ids=lambda path: path.stem)
def test_a_study_from_python_has_the_runs_of_its_file(path):
    file = loaded(path)
    made = labbook.define(json.loads(json.dumps(file.definition)))
    assert keys(made) == keys(file)
    assert (made.replicates, made.measure, made.fit, made.reference) == (
        file.replicates,
        file.measure,
        file.fit,
        file.reference,
    )


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_a_saved_study_is_the_same_study(path, tmp_path):
    study = loaded(path)
    again = labbook.load(study.change(about="saved").save(tmp_path / "saved.yaml"))
    assert keys(again) == keys(study)
    assert again.about == "saved"
    assert again.reference == study.reference


@pytest.mark.parametrize(
    "values",
    [
        lambda _: ["18 mm", "24 mm"],
        lambda _: ("18 mm", "24 mm"),
        lambda _: np.array(["18 mm", "24 mm"]),
        lambda units: [units.Quantity(18, "mm"), units.Quantity(0.024, "m")],
        lambda units: units.Quantity(np.array([1.8, 2.4]), "cm"),
    ],
    ids=["list", "tuple", "array", "quantities", "array of a unit"],
)
def test_sweeps_are_any_sequence(units, values):
    assert keys(labbook.define({**PLAIN, "sweep": {"container.orifice": values(units)}})) == keys(labbook.define(PLAIN))


def test_numbers_are_those_of_numpy_too(units):
    frictions = np.linspace(0.3, 0.5, 3)
    made = labbook.define({**PLAIN, "sweep": {"contact.friction": frictions}}, replicates=int(np.int64(2)))
    assert [point.at["contact.friction"] for point in made.points] == pytest.approx([0.3, 0.4, 0.5])
    assert made.replicates == 2
    density = units.Quantity(2.5, "g/cm^3")
    assert keys(labbook.define(PLAIN).change({"grains.density": density})) == keys(labbook.define(PLAIN))


def test_a_change_leaves_the_study_as_it_is():
    study = labbook.define(PLAIN)
    other = study.change({"contact.friction": 0.3, "sweep.container.orifice": ["20 mm"]}, replicates=5)
    assert [point.scene.contact.friction for point in other.points] == [0.3]
    assert other.replicates == 5
    assert study == labbook.define(PLAIN)
    assert study.points[0].scene.contact.friction == 0.5
    assert other.path == Path("study hopper")


def test_none_leaves_a_key_out():
    study = labbook.define(PLAIN).change({"container.angle": "60 deg"})
    assert keys(study) != keys(labbook.define(PLAIN))
    assert keys(study.change({"container.angle": None})) == keys(labbook.define(PLAIN))
    assert len(study.change(sweep=None).points) == 1


def told(raised) -> list[tuple[str, str]]:
    return [(one.key, one.remedy) for one in raised.value.problems]


@pytest.mark.parametrize(
    ("changes", "key", "remedy"),
    [
        ({"contact.frictoin": 0.2}, "contact.frictoin", "did you mean friction"),
        ({"grains.diameter": 3}, "grains.diameter", "for example 30 mm"),
        ({"container.orifice": "20 mm"}, "container.orifice", "change sweep.container.orifice"),
        ({"name.first": "a"}, "name.first", "give name as a whole"),
        ({"sweep.container.orifice": []}, "sweep.container.orifice", "list at least one value"),
        ({"measure": {"flow_rate"}}, "measure", "a list"),
        ({"window": {15: "start"}}, "window", "in quotes"),
        ({"colour": "red"}, "colour", "known here"),
        ({"points": [{"container.orifice": "18 mm"}]}, "sweep.container.orifice", "keep one"),
    ],
)
def test_mistakes_name_key_and_remedy(changes, key, remedy):
    with pytest.raises(labbook.StudyError) as raised:
        labbook.define(PLAIN).change(changes)
    assert any(one == key and remedy in how for one, how in told(raised)), told(raised)
    assert str(raised.value).startswith("study hopper: ")


def test_all_mistakes_are_told_at_once_and_as_for_a_file(tmp_path):
    wrong = {**PLAIN, "grains": {**PLAIN["grains"], "diameter": 3, "cuont": 5}, "replicates": 0}
    with pytest.raises(labbook.StudyError) as made:
        labbook.define(wrong)
    path = tmp_path / "wrong.yaml"
    path.write_text(json.dumps(wrong))
    with pytest.raises(labbook.StudyError) as read:
        labbook.load(path)
    assert sorted(told(made)) == sorted(told(read))
    assert len(told(made)) >= 3


def test_a_key_is_given_once():
    with pytest.raises(labbook.StudyError, match="replicates: given twice"):
        labbook.define({**PLAIN, "replicates": 2}, replicates=3)


def test_what_refers_to_itself_is_refused():
    endless: dict = dict(PLAIN)
    endless["walls"] = endless
    with pytest.raises(labbook.StudyError, match="too deep"):
        labbook.define(endless)


def test_points_are_a_frame_with_units():
    frame = labbook.define(PLAIN).frame()
    assert list(frame["container.orifice"]) == [0.018, 0.024]
    assert frame.attrs["units"] == {"container.orifice": "m"}


# not of the drum: a picture of what is not filled yet has no grains in a mesh that lies
@pytest.mark.parametrize("path", [path for path in STUDIES if path.stem != "drum"], ids=lambda path: path.stem)
def test_a_study_shows_its_sweep_and_its_scene(path):
    from xml.etree import ElementTree

    study = labbook.load(path)
    html = study._repr_html_()
    assert study.name in repr(study)
    assert all(key in html for key in study.points[0].at)
    picture = ElementTree.fromstring(study.points[0].scene.svg())
    paths = [one for one in picture.iter() if one.tag.endswith("path")]
    drawn = sum(one.attrib["d"].count("M") for one in paths)
    scene = study.points[0].scene
    assert min(scene.grains.count, 4000) * 0.05 < drawn <= scene.grains.count + 3
    if (orifice := getattr(scene.container, "orifice", None)) is not None:
        assert f"D = {orifice * 1e3:.4g} mm" in "".join(picture.itertext())


def test_grains_and_outlet_are_to_scale():
    import re

    scene = labbook.define(PLAIN).points[1].scene
    svg = scene.svg()
    width = float(re.search(r'stroke-width="([\d.]+)" stroke-linecap="round" fill="none"', svg)[1])  # pyright: ignore[reportOptionalSubscript]
    lines = [tuple(map(float, ends)) for ends in re.findall(r'x1="([\d.]+)" y1="[\d.]+" x2="([\d.]+)"', svg)]
    outer = max(max(ends) for ends in lines) - min(min(ends) for ends in lines)
    assert width / outer == pytest.approx(3 / 60, rel=0.05)
    assert any(abs(b - a) / outer == pytest.approx(24 / 60, rel=0.01) for a, b in lines)


def test_free_space_has_no_picture():
    point = labbook.define(PLAIN).points[0]
    scene = Scene(grains=point.scene.grains, contact=point.scene.contact, container=Primitives())
    assert scene.svg() == ""
    assert scene._repr_svg_() is None
    assert "200 spheres" in repr(scene)


@pytest.mark.parametrize("wrong", ["replicates=4", ["replicates", 4], 4, [], ""])
def test_what_is_no_dict_is_said(wrong):
    with pytest.raises(TypeError, match=r"a dict of keys and values is needed.*change\(replicates=4\)"):
        labbook.define(PLAIN).change(wrong)
    with pytest.raises(TypeError, match=r"a dict of keys and values is needed.*labbook\.load\(path\)"):
        labbook.define(wrong)


def test_a_key_that_is_no_text_is_said():
    with pytest.raises(labbook.StudyError, match="3 is not a key: keys are text"):
        labbook.define(PLAIN).change({3: 4})  # pyright: ignore[reportArgumentType]
    with pytest.raises(labbook.StudyError, match="3 is not a key: keys are text"):
        labbook.define({**PLAIN, 3: 4})  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("first", ["container", "container.width"])
def test_a_section_and_a_key_of_it_are_not_changed_at_once(first):
    changes = {"container.width": "60 mm", "container": {**PLAIN["container"], "width": "50 mm"}}
    with pytest.raises(labbook.StudyError) as caught:
        labbook.define(PLAIN).change({first: changes[first], **changes})
    (problem,) = caught.value.problems
    assert problem.key == "container.width"
    assert problem.message == "given twice: here and within container"


def test_one_name_stands_for_a_list_of_one():
    study = labbook.define(PLAIN, fit="beverloo", measure="flow_rate")
    assert (study.fit, study.measure) == (("beverloo",), ("flow_rate",))
    assert labbook.define(PLAIN).change(fit="beverloo").fit == ("beverloo",)
    with pytest.raises(labbook.StudyError, match=r"no law is called beverlo\n.*did you mean beverloo\?"):
        labbook.define(PLAIN, fit="beverlo")


def test_studies_are_keys_of_a_cache():
    one, same, other = labbook.define(PLAIN), labbook.define(PLAIN), labbook.define(PLAIN, replicates=2)
    kept = {one: 1, other: 2}
    assert kept[same] == 1
    assert kept[labbook.define(PLAIN, replicates=2)] == 2
    assert all(hash(labbook.load(path)) == hash(loaded(path)) for path in STUDIES[:3])
