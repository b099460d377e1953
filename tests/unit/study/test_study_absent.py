"""What labbook does not have is said so, with what to do instead: row by row of the table, and word by word."""

from typing import Any

import pytest

import labbook
from labbook.measure import MEASURES
from labbook.study import StudyError
from labbook.study.absent import TABLE, absent, plain
from labbook.study.habits import KEYS_BY_HABIT as habits
from labbook.study.keys import all_keys, find

BASE: dict[str, Any] = {
    "name": "x",
    "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 600}
    | {"sizes": {"kind": "uniform", "smallest": "2 mm"}},
    "contact": {"law": "linear", "normal_stiffness": "2000 N/m", "friction": 0.5, "restitution": 0.5},
    "container": {"kind": "wedge-hopper", "width": "48 mm", "height": "200 mm", "thickness": "1.01 d"}
    | {"orifice": "21 mm"},
    "walls": {"front": {"friction": 0.1}},
    "numerics": {},
    "fill": {"kind": "rain", "contact": {"law": "linear", "normal_stiffness": "2000 N/m", "restitution": 0.5}},
    "feed": {"kind": "reinject"},
    "reference": {"source": "x", "flow_rate": [{"value": "1 g/s"}]},
}
KINDS = [{"name": "a", "share": 0.5}, {"name": "b", "share": 0.5}]
PLATES: dict[str, Any] = {
    "kind": "primitives",
    "parts": [{"name": "floor", "shape": {"kind": "plane", "point": ["0 mm"] * 3, "normal": [0, 0, 1]}}],
}

ROWS = [(row, place, word) for row in TABLE for place in row.at.split() for word in row.words.split()]


def problems(data):
    with pytest.raises(StudyError) as caught:
        labbook.define(data)
    return caught.value.problems


def put(data: Any, place: list[str], value: Any) -> Any:
    head, *rest = place
    if head == "[]":
        return [put(data[0], rest, value) if rest else value, *data[1:]]
    return {**data, head: put(data.get(head, {}), rest, value) if rest else value}


def written(place: str, word: str) -> dict[str, Any]:
    """A study with the word at a place of the table, as a value where the place is a key, else as a key."""
    data = BASE
    if place.startswith("container.parts"):
        data = {**BASE, "container": PLATES}
    if place.startswith("grains.kinds"):
        data = put({**BASE, "grains": {**BASE["grains"], "kinds": KINDS}}, ["grains", "sizes"], None)
        del data["grains"]["sizes"]
    if place.startswith("contact.between"):
        data = put(
            {**BASE, "grains": {**BASE["grains"], "kinds": KINDS}}, ["contact", "between"], [{"kinds": ["a", "b"]}]
        )
        del data["grains"]["sizes"]
    if place == "measure":
        return {**data, "measure": ["flow_rate", word]}
    if place == "fit":
        return {**data, "fit": [word]}
    keys = [] if place == "." else place.replace("[]", ".[]").replace("*", "front").split(".")
    if place.startswith("reference."):
        keys = ["reference", "flow_rate", *keys[2:]]
        if "[]" not in place:
            data = put(data, keys, {"value": "1 g/s"})
    value = find(place) and place not in ("walls.*",)
    if word == "[]":
        return put(data, keys, ["0 m/s^2", "9.81 m/s^2"])
    return put(data, keys, word) if value else put(data, [*keys, word], 1)


PLACES = [(row, place) for row in TABLE for place in row.at.split()]


@pytest.mark.parametrize(("row", "place"), PLACES, ids=[f"{place}-{row.words.split()[0]}" for row, place in PLACES])
def test_every_row_is_told_where_its_words_stand(row, place):
    word = row.words.split()[0]
    (told,) = problems(written(place, word))
    assert row.says in told.message
    assert told.remedy.endswith(row.remedy)
    assert all(absent("" if place == "." else place.replace("*", "front"), word) is row for word in row.words.split())


def test_no_word_stands_twice_at_a_place():
    seen = [(place, word) for _, place, word in ROWS]
    assert len(seen) == len(set(seen))


def test_no_word_is_one_that_labbook_has():
    """A measure or a choice that is added later has to leave the table."""
    keys = {(section or ".", plain(leaf)) for section, _, leaf in (key.name.rpartition(".") for key in all_keys())}
    keys |= {(key.name, plain(choice)) for key in all_keys() for choice in key.choices}
    keys |= {("measure", plain(name)) for name in MEASURES}
    keys |= {(key.rpartition(".")[0], word) for word, key in habits.items()} | {(".", word) for word in habits}
    assert not keys & {(place, word) for _, place, word in ROWS}


@pytest.mark.parametrize(
    ("changes", "key", "message", "remedy"),
    [
        (
            {"container": {"kind": "mesh", "file": "hopper.stl"}},
            "container.kind",
            "mesh",
            "parts: [{name: hopper, shape: {kind: mesh, file: hopper.stl, unit: mm}}]",
        ),
        ({"container": {"file": "hopper.stl"}}, "container.file", "surface from a file", "primitives"),
        ({"contact.surface_energy": "0.1 J/m^2"}, "contact.surface_energy", "no cohesion", "dry"),
        ({"fluid": {"density": "1 kg/m^3"}}, "fluid", "no fluid", "leave it out"),
        ({"grains.sizes": {"kind": "weibull"}}, "grains.sizes.kind", "no such distribution", "lognormal"),
        ({"grains.sizes": {"kind": "psd"}}, "grains.sizes.kind", "another name", "mass_fractions"),
        ({"feed": {"massrate": "1 kg/s"}}, "feed.massrate", "new grains enter by the stream", "kind: rate"),
        ({"gravity": ["0 m/s^2", "-9.81 m/s^2"]}, "gravity", "along -z", "9.81 m/s^2"),
        ({"gravity": {"z": "-9.81 m/s^2"}}, "gravity", "along -z", "9.81 m/s^2"),
        ({"contact.rolling_model": "EPSD2"}, "contact.rolling_model", "k_r = k_t R^2", "rolling_damping"),
        ({"reference": "data/measured.csv"}, "reference", "under reference.file", "flow_rate: [{at:"),
        ({"reference": {"source": "x", "flow_rate": "w.txt"}}, "reference.flow_rate", "under reference.file", "value"),
        ({"sweep": {"contact.cohesion": [1, 2]}}, "sweep.contact.cohesion", "no such key", "no cohesion"),
        ({"fit": ["critical_size"]}, "fit", "no law is called critical_size: laws of avalanches", "clogging"),
        ({"fill": {"bottom": "1 mm"}}, "fill.bottom", "stays where it is", "fill.mobilise"),
        ({"measure": ["wall_force"]}, "measure", "no measurement is called wall_force: forces", "wall_stress"),
    ],
)
def test_as_people_write_it(changes, key, message, remedy):
    with pytest.raises(StudyError) as caught:
        labbook.define(BASE).change(changes)
    told = next(problem for problem in caught.value.problems if problem.key == key)
    assert message in told.message
    assert remedy in told.remedy


def test_a_collision_time_is_one_problem_that_names_the_key():
    contact = {"law": "linear", "collision_time": "1 ms", "friction": 0.5, "restitution": 0.5}
    (told,) = problems({**BASE, "contact": contact})
    assert "contact.contact_time" in told.remedy


def test_an_outlet_plane_belongs_to_primitives():
    base = {key: value for key, value in BASE.items() if key not in ("walls", "feed")}
    for silo in (BASE["container"], {"kind": "cylinder-silo", "diameter": "4 cm", "height": "1 m", "orifice": "2 cm"}):
        (told,) = problems({**base, "container": {**silo, "outlet_plane": "0 mm"}})
        assert told.message == "this key belongs to kind: primitives"
        assert "outlet_plane" not in told.remedy
        (told,) = problems({**base, "container": {**silo, "lenght": "1 mm"}})
        assert "outlet_plane" not in told.remedy
    (told,) = problems({**base, "container": {**PLATES, "gap": "1 mm"}})
    assert "parts" in told.remedy
    wrong = {**PLATES["parts"][0], "shape": {**PLATES["parts"][0]["shape"], "gap": "1 mm"}}
    (told,) = problems({**base, "container": {**PLATES, "parts": [wrong]}})
    assert told.remedy == "known here: kind, normal, point"


def test_a_frustum_that_narrows_upwards_is_written_with_its_inner_edge_first():
    part = {"name": "roof", "shape": {"kind": "frustum", "lower": ["50 mm", "0 mm"], "upper": ["20 mm", "30 mm"]}}
    told = next(iter(problems({**BASE, "container": {"kind": "primitives", "parts": [part]}})))
    assert told.key == "container.parts[0].shape.upper"
    assert told.remedy == "the same cone is lower: [20 mm, 30 mm], upper: [50 mm, 0 mm]"
