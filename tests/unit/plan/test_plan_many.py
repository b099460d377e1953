"""Plans of many points: every key is the one of its point alone."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from labbook_dem import features
from labbook_toy import Backend
from toy_lab import carry_out, study, study_file

from labbook.backend.numerics import Numerics
from labbook.filling.bed import PACKED, discharged_at, expected_bed_height
from labbook.lab import Catalogue, LabFolder, identity
from labbook.plan import plan as planning
from labbook.plan.advice import foresee
from labbook.plan.demand import PointDemand
from labbook.plan.plan import Planner
from labbook.plan.possible import check
from labbook.scene import (
    Box,
    ConicalSilo,
    CylinderSilo,
    HertzMindlin,
    LinearSpringDashpot,
    Scene,
    Spheres,
    SurfaceChange,
    Wall,
    WedgeHopper,
    timescales,
)
from labbook.scene.grains import Kind
from labbook.scene.model import Text, canonical, once
from labbook.study import StudyError, load

GRAINS = Spheres(diameter=3e-3, density=2500, count=3000)
LAW = HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25, friction=0.5, restitution=0.2)
sizes = st.floats(0.02, 0.06)
CONTAINERS = st.one_of(
    st.builds(
        lambda orifice, angle, closed: WedgeHopper(
            width=0.1, height=0.4, thickness=3.1e-3, orifice=orifice, angle=angle, closed=closed
        ),
        sizes,
        st.one_of(st.floats(0.3, 1.5), st.just(math.pi / 2)),
        st.booleans(),
    ),
    st.builds(lambda d: WedgeHopper(width=0.1, height=0.4, thickness=3.1e-3, orifice=d, gap=0.0, angle=1.0), sizes),
    st.builds(lambda d, f: CylinderSilo(diameter=0.1, height=0.3, orifice=d, rotation=f), sizes, st.floats(-2, 2)),
    st.builds(lambda d, angle: ConicalSilo(diameter=0.1, height=0.3, orifice=d, angle=angle), sizes, st.floats(0.5, 1)),
    st.builds(lambda w, lid: Box(width=w, depth=0.01, height=0.2, lid=lid), sizes, st.booleans()),
)


def scene(container, **changes) -> Scene:
    return Scene(**{"grains": GRAINS, "contact": LAW, "container": container, **changes})


@given(CONTAINERS, st.sampled_from([{}, {"all": SurfaceChange(friction=0.3)}]))
def test_what_a_scene_hashes_is_the_json_of_its_walls_however_it_is_put_together(container, walls):
    made = scene(container, walls=walls)
    stated = [
        {**wall.model_dump(mode="json"), "surface": made.surface(wall).model_dump(mode="json")}
        for wall in container.walls()
    ]
    text = json.dumps(stated, sort_keys=True, separators=(",", ":")).replace("-0.0,", "0.0,").replace("-0.0]", "0.0]")
    assert canonical(identity.scene_identity(made)["walls"]) == text


@given(CONTAINERS)
def test_walls_that_are_made_without_validation_are_those_that_it_gives(container):
    for wall in (*container.walls(), *container.close().walls()):
        given_back = Wall.model_validate(json.loads(wall.model_dump_json()))
        assert given_back == wall
        assert repr(given_back) == repr(wall), "numbers of the same types"


@given(CONTAINERS, st.integers(10, 100_000))
def test_a_bed_is_as_high_as_the_volume_of_its_grains_asks(container, count):
    made = scene(container, grains=GRAINS.model_copy(update={"count": count}))
    height = expected_bed_height(made)
    assert height is not None
    assert abs(discharged_at(made, height) or 0.0) < 1e-12, f"at a packing fraction of {PACKED} all grains lie below"


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"walls": {"left": SurfaceChange(restitution=0.9)}},
        {"walls": {"left": SurfaceChange(shear_modulus=1e9)}},
        {"grains": GRAINS.model_copy(update={"kinds": (Kind(name="a", share=1.0, shear_modulus=1e8),)})},
    ],
)
def test_time_scales_are_the_same_in_other_containers_only_where_walls_are_like_the_grains(changes):
    made = scene(WedgeHopper(width=0.1, height=0.4, thickness=3.1e-3, orifice=0.03), **changes)
    for time in (timescales.rayleigh, timescales.collision, timescales.largest_stable_step):
        assert time(made) == time.__wrapped__(made)  # pyright: ignore[reportFunctionMemberAccess]


def test_what_is_canonical_already_is_taken_as_it_stands():
    part = canonical({"b": 1, "a": -0.0})
    assert canonical({"x": [part], "y": part}) == '{"x":[{"a":0.0,"b":1}],"y":{"a":0.0,"b":1}}'
    assert canonical("{}") != canonical(Text("{}")), "text that is only text is quoted"


def test_values_without_a_hash_are_worked_out_each_time():
    asked = []
    length = once(8)(lambda value: asked.append(value) or len(value))
    assert [length((1, 2)), length((1, 2)), length([1]), length([1])] == [2, 2, 1, 1]
    assert asked == [(1, 2), [1], [1]]


def many(folder, replicates=1):
    """30 points: three frictions by ten outlets."""
    path = study_file(folder, orifices="[18, 19, 20, 21, 22, 23, 24, 25, 26, 27]", replicates=replicates)
    text = path.read_text().replace("sweep:\n", "sweep:\n  contact.friction: [0.3, 0.4, 0.5]\n")
    path.write_text(text)
    return path


def test_a_problem_names_all_points_that_have_it(tmp_path):
    path = many(tmp_path)
    path.write_text(path.read_text().replace("[0.3, 0.4, 0.5]", "[0.3, much, -1]").replace(", 27]", ", 70]"))
    with pytest.raises(StudyError) as error:
        load(path)
    told = [(problem.key, problem.message) for problem in error.value.problems]
    assert {key for key, _ in told} == {"contact.friction", "container.orifice"}
    assert any("friction 0.3" in message and "2 other points" in message for _, message in told)


def test_keys_of_a_plan_are_those_of_its_points_alone(tmp_path):
    path = many(tmp_path)
    backend, asked = Backend(), load(path)
    made = foresee(asked, Catalogue(tmp_path / "lab"), backend, "cpu")
    for item in made.items:
        point = item.demand.point
        alone = load_alone(path, point.at)
        assert alone.scene == point.scene
        closed = Scene.model_validate_json(alone.scene.close(alone.fill.friction).model_dump_json())
        keys = identity.run_keys(
            identity.scene_key(Scene.model_validate_json(alone.scene.model_dump_json())),
            identity.scene_key(closed),
            item.demand.filling,
            alone.numerics,
            backend.capabilities,
        )
        assert item.keys == keys


def load_alone(path, at):
    """The only point of the study without a sweep, with the values `at`."""
    told = load(path).change({"sweep": None})
    values = {"contact.friction": at["contact.friction"], "container.orifice": f"{at['container.orifice'] * 1e3!r} mm"}
    return told.change(values).points[0]


def test_a_plan_asks_the_index_once_and_looks_for_no_run_that_is_not_there(tmp_path, monkeypatch):
    lab, asked = tmp_path / "lab", load(many(tmp_path, replicates=4))
    some = asked.change({"contact.friction": 0.3, "sweep.contact.friction": None, "sweep.container.orifice": "[18] mm"})
    carry_out(some, lab)
    looked, settled, queries = [], [], []
    looked_at, settling, entries = Planner._read_entry, Catalogue.settling, Catalogue.entries
    monkeypatch.setattr(Planner, "_read_entry", lambda self, key: looked.append(key) or looked_at(self, key))
    monkeypatch.setattr(Catalogue, "settling", lambda self: settled.append(self) or settling(self))
    monkeypatch.setattr(Catalogue, "entries", lambda self, *of: queries.append(of) or entries(self, *of))
    made = foresee(asked, Catalogue(lab), Backend(), "cpu")
    assert made.counts() == {"done": 4, "missing": 116}
    assert (len(settled), len(queries)) == (1, 2), "of what is not there by the law as it is now, older versions"
    assert not looked


@pytest.mark.parametrize("few", [0, 10**6])
def test_runs_that_are_listed_stand_as_those_that_are_looked_for_one_by_one(tmp_path, monkeypatch, few):
    lab, asked = LabFolder(tmp_path / "lab"), study(tmp_path, replicates=3)
    carry_out(asked, lab.folder)
    first, *between, last = Planner(asked, Catalogue(lab), Backend().capabilities).plan().items
    lab.run(last.keys.run).rename(lab.folder / "gone")  # it is in the index alone
    packing = lab.packing(first.keys.packing)
    (packing / "packing.json").write_text("{}")
    monkeypatch.setattr(planning, "_LISTING_FROM", few)
    items = Planner(asked, Catalogue(lab), Backend().capabilities).plan().items
    stands = {item.keys.run: (item.state, item.packed) for item in items}
    assert stands[first.keys.run] == ("missing", False), "its packing cannot be read"
    assert stands[last.keys.run] == ("missing", True)
    others = [item.keys for item in between if item.keys.packing != first.keys.packing]
    assert others
    assert all(stands[keys.run] == ("done", True) for keys in others)


def test_more_keys_than_rows_find_the_rows_that_fewer_find(tmp_path):
    lab, asked = tmp_path / "lab", study(tmp_path, replicates=3)
    carry_out(asked, lab)
    catalogue = Catalogue(lab)
    keys = [item.keys.run for item in Planner(asked, catalogue, Backend().capabilities).plan().items]
    strangers = [f"{number:024x}" for number in range(2000)]
    assert len(keys) == 6
    few, more = catalogue.entries(keys[:4]), catalogue.entries([*strangers, *keys[:4]])
    assert sorted(one.run_key for one in more) == sorted(one.run_key for one in few) == sorted(keys[:4])


def test_features_are_worked_out_once_for_scenes_that_differ_in_sizes():
    found = []
    can = features.capabilities("any", 1, frozenset({"double"}), ("cpu",), mixtures=True)
    numerics = Numerics(dt=1e-6)
    for orifice in (0.02, 0.025, 0.03):
        container = WedgeHopper(width=0.1, height=0.4, thickness=3.1e-3, orifice=orifice, angle=1.0)
        found.append(features.specialise(can, scene(container), numerics, ()))
    assert found[0] is found[1] is found[2]
    other = LinearSpringDashpot(normal_stiffness=1e3, friction=0.5)
    container = WedgeHopper(width=0.1, height=0.4, thickness=3.1e-3, orifice=0.03, angle=1.0)
    assert features.specialise(can, scene(container, contact=other), numerics, ()) != found[0]


def test_a_check_before_a_plan_makes_its_keys(tmp_path, monkeypatch):
    planner = Planner(load(many(tmp_path)), Catalogue(tmp_path / "lab"), Backend().capabilities)
    check(Backend(), "cpu", planner.points)
    monkeypatch.setattr(identity, "scene_key", lambda scene: pytest.fail("made again"))
    assert len(planner.plan().items) == 30
    assert all(isinstance(one, PointDemand) for one in planner.points)
