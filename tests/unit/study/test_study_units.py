"""Every key with a unit, in every spelling of that unit: the same physics, or a refusal that says what to write.

The keys are those that the models have, so that a new one cannot be forgotten. Expected numbers are definitions of the
units; a turn is 2 pi rad.
"""

import math
import pathlib
import re
import shutil
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

import labbook
from labbook.scene.quantities import parse
from labbook.study import StudyError
from labbook.study.keys import all_keys, find

SPELLINGS: dict[str, dict[str, float]] = {
    "m": {"m": 1, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6, "km": 1e3},
    "s": {"s": 1, "ms": 1e-3, "us": 1e-6, "min": 60, "h": 3600},
    "kg/m^3": {"kg/m^3": 1, "g/cm^3": 1e3, "kg/m**3": 1, "t/m^3": 1e3, "kg m^-3": 1},
    "Pa": {"Pa": 1, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "N/m^2": 1, "N/mm^2": 1e6, "bar": 1e5},
    "N/m": {"N/m": 1, "kN/m": 1e3, "N/mm": 1e3, "kg/s^2": 1, "J/m^2": 1},
    "m/s^2": {"m/s^2": 1, "cm/s^2": 1e-2, "mm/ms^2": 1e3},
    "m/s": {"m/s": 1, "mm/s": 1e-3, "cm/s": 1e-2, "km/h": 1 / 3.6, "m/min": 1 / 60},
    "rad": {
        "rad": 1,
        "deg": math.pi / 180,
        "°": math.pi / 180,
        "turn": 2 * math.pi,
        "mrad": 1e-3,
        "gon": math.pi / 200,
    },
    "Hz": {
        "Hz": 1,
        "1/s": 1,
        "/s": 1,
        "s^-1": 1,
        "kHz": 1e3,
        "1/min": 1 / 60,
        "rpm": 1 / 60,
        "turn/s": 1,
        "rev/min": 1 / 60,
        "rad/s": 1 / (2 * math.pi),
        "rad/min": 1 / (120 * math.pi),
        "deg/s": 1 / 360,
        "°/s": 1 / 360,
    },
    "kg/s": {"kg/s": 1, "g/s": 1e-3, "kg/h": 1 / 3600, "t/h": 1 / 3.6},
    "rad/s": {
        "rad/s": 1,
        "deg/s": math.pi / 180,
        "°/s": math.pi / 180,
        "rpm": math.pi / 30,
        "rev/min": math.pi / 30,
        "turn/s": 2 * math.pi,
        "Hz": 2 * math.pi,
        "kHz": 2e3 * math.pi,
        "rad s^-1": 1,
    },
}
"""By SI unit: what it may be written in, and how much of it one of that is."""

FOREIGN = ("", "kg", "rad", "deg", "Hz", "rpm", "rad/s", "1/s", "m", "s", "%")
"""Units of which most belong to another dimension; which those are follows from the table above."""

GRAINS = {"shape": "sphere", "diameter": "0.003 m", "density": "2500 kg/m^3", "count": 100}
HERTZ = {"law": "hertz-mindlin", "shear_modulus": "5e6 Pa", "poisson_ratio": 0.25, "friction": 0.5, "restitution": 0.5}
COLLISION = {"law": "linear", "friction": 0.5, "restitution": 0.5}
LINEAR = {**COLLISION, "normal_stiffness": "2000 N/m"}
WEDGE = {
    "kind": "wedge-hopper",
    "width": "0.06 m",
    "height": "0.2 m",
    "thickness": "0.004 m",
    "angle": "1 rad",
    "orifice": "0.02 m",
    "gap": "0.01 m",
    "lip": {"radius": "0.002 m", "thickness": "0.008 m"},
}
CYLINDER = {"kind": "cylinder-silo", "diameter": "0.1 m", "height": "0.4 m", "orifice": "0.03 m", "rotation": "1 Hz"}
PLANE = {"kind": "plane", "point": ["0.01 m", "0.02 m", "-0.3 m"], "normal": [0, 0, 1]}
FRUSTUM = {"kind": "frustum", "lower": ["0.01 m", "0 m"], "upper": ["0.05 m", "0.04 m"]}
THICK = {
    "kind": "thick-plate",
    "far": ["0.045 m", "0.05 m"],
    "edge": ["0.04 m", "0.04 m"],
    "foot": ["0.04 m", "0.03 m"],
}
THICK |= {"radius": "0.002 m", "turned": True}
STRIP = {"kind": "strip", "start": ["-0.05 m", "0.1 m"], "end": ["-0.04 m", "0.2 m"]}

MESH = {"kind": "mesh", "file": "tetrahedron.obj", "unit": "mm", "smooth": "0.2 rad"}
MESH |= {"rotate": ["0.1 rad", "0.2 rad", "0.3 rad"], "at": ["0.001 m", "0.002 m", "0.1 m"]}

STREAM = {"rate": "0.1 kg/s", "low": ["-0.02 m", "-0.02 m", "0.3 m"], "high": ["0.02 m", "0.02 m", "0.35 m"]}
STREAM |= {"velocity": ["0.01 m/s", "0.02 m/s", "-0.5 m/s"], "every": "0.1 s"}

STUDIES: dict[str, dict[str, Any]] = {
    "mesh": {
        "grains": GRAINS,
        "contact": LINEAR,
        "container": {**CYLINDER, "parts": [{"name": "insert", "shape": MESH}]},
    },
    "wedge": {
        "grains": {
            **GRAINS,
            "kinds": [
                {"name": "a", "share": 0.5, "diameter": "0.002 m", "density": "1000 kg/m^3", "shear_modulus": "4e6 Pa"},
                {"name": "b", "share": 0.5, "youngs_modulus": "9e6 Pa"},
            ],
        },
        "contact": HERTZ,
        "container": WEDGE,
        "walls": {"front": {"shear_modulus": "6e6 Pa"}, "back": {"youngs_modulus": "7e6 Pa"}},
        "gravity": "9.81 m/s^2",
        "fill": {"contact": HERTZ, "max_time": "30 s", "numerics": {"dt": "1e-6 s", "speed_limit": "50 m/s"}},
        "numerics": {"dt": "2e-6 s", "speed_limit": "60 m/s"},
        "window": {
            "after": "0.5 s",
            "until": "2 s",
            "gap": "1 s",
            "moment": "0.05 s",
            "interval": "0.05 s",
            "layer": "0.01 m",
        },
        "stop": {"max_time": "20 s", "stall": "1 s", "discharged": 1},
        "record": {"every": "0.01 s"},
    },
    "cylinder": {
        "grains": {**GRAINS, "sizes": {"kind": "normal", "mean": "0.0025 m", "deviation": "0.0001 m"}},
        "contact": LINEAR,
        "container": CYLINDER,
        "walls": {"side": {"normal_stiffness": "3000 N/m"}},
        "fill": {"contact": LINEAR, "mobilise": {"bottom": "0.0001 m", "velocity": "0.001 m/s"}},
        "stop": {"fill_height": "0.0002 m"},
    },
    "pairs": {
        "grains": {**GRAINS, "kinds": [{"name": "a", "share": 0.5}, {"name": "b", "share": 0.5}]},
        "contact": {**LINEAR, "between": [{"kinds": ["a", "b"], "normal_stiffness": "1500 N/m"}]},
        "container": {"kind": "box", "width": "0.05 m", "depth": "0.06 m", "height": "0.07 m"},
        "fill": {"contact": {**LINEAR, "between": [{"kinds": ["a", "b"], "normal_stiffness": "1500 N/m"}]}},
        "measure": ["packing"],
    },
    "cone": {
        "grains": {**GRAINS, "sizes": {"kind": "uniform", "smallest": "0.002 m"}},
        "contact": {"law": "hertz-lammps", **{k: v for k, v in HERTZ.items() if k not in ("law", "shear_modulus")}}
        | {"youngs_modulus": "8e6 Pa"},
        "container": {
            "kind": "conical-silo",
            "diameter": "0.1 m",
            "height": "0.4 m",
            "orifice": "0.03 m",
            "angle": "1 rad",
        },
        "fill": {
            "contact": {k: v for k, v in HERTZ.items() if k != "shear_modulus"} | {"youngs_modulus": "8e6 Pa"},
        },
    },
    "lognormal": {
        "grains": {
            **GRAINS,
            "sizes": {"kind": "lognormal", "median": "0.002 m", "spread": 0.3, "smallest": "0.001 m"},
        },
        "contact": {**COLLISION, "contact_time": "0.0002 s"},
        "container": CYLINDER,
        "fill": {"contact": {**COLLISION, "contact_time": "0.0002 s"}},
    },
    "table": {
        "grains": {
            **GRAINS,
            "sizes": {"kind": "table", "diameters": ["0.002 m", "0.003 m"], "mass_fractions": [0.5, 0.5]},
        },
        "contact": {**COLLISION, "largest_overlap": "0.00002 m", "impact_speed": "1 m/s"},
        "container": CYLINDER,
        "fill": {"contact": {**COLLISION, "largest_overlap": "0.00002 m", "impact_speed": "1 m/s"}},
    },
    "file": {
        "grains": GRAINS,
        "contact": HERTZ,
        "container": CYLINDER,
        "fill": {"kind": "file", "file": "grains.csv", "shift": ["0.001 m", "0 m", "0.002 m"]},
    },
    "fed": {
        "grains": GRAINS,
        "contact": HERTZ,
        "container": CYLINDER,
        "feed": {"kind": "reinject"},
        "restart": {"kind": "break", "wait": "0.3 s"},
        "stop": {"max_time": "10 s"},
        "measure": ["clogging"],
    },
    "poured": {
        "grains": GRAINS,
        "contact": HERTZ,
        "container": {
            **CYLINDER,
            "sink": "-0.2 m",
            "planes": [{"name": "below", "z": "-0.1 m"}],
            "parts": [{"name": "ledge", "shape": THICK}],
        },
        "feed": {"kind": "rate", "stream": STREAM},
        "fill": {"kind": "stream", "stream": STREAM, "until": "2 s"},
        "stop": {"max_time": "10 s"},
    },
    "clumps": {
        "grains": {
            "shape": "clump",
            "diameter": "0.002 m",
            "centres": [["0 m", "0.0003 m", "-0.0005 m"], ["0 m", "0 m", "0.0006 m"]],
            "diameters": ["0.002 m", "0.0015 m"],
            "density": "1300 kg/m^3",
            "count": 10,
        },
        "contact": HERTZ,
        "container": {"kind": "cylinder-silo", "diameter": "0.05 m", "height": "0.1 m", "orifice": "0.03 m"},
    },
    "walls": {
        "grains": {
            "shape": "spherocylinder",
            "diameter": "0.002 m",
            "length": "0.005 m",
            "density": "2500 kg/m^3",
            "count": 10,
        },
        "contact": HERTZ,
        "container": {
            "kind": "primitives",
            "outlet_plane": "-0.02 m",
            "parts": [
                {"name": "floor", "shape": PLANE, "motion": {"velocity": ["0.01 m/s", "0.02 m/s", "0 m/s"]}},
                {"name": "cone", "shape": FRUSTUM, "motion": {"spin": "2 rad/s"}},
                {"name": "plate", "shape": STRIP},
            ],
        },
    },
}


@pytest.fixture(autouse=True)
def _beside(tmp_path, monkeypatch):
    """Files that studies made in Python name lie in the current folder: a mesh, and a start of 100 grains far from each
    other and from the walls."""
    rows = [f"{10 * (k % 5) - 20},{10 * (k // 5 % 5) - 20},{10 * (k // 25) + 10}" for k in range(100)]
    (tmp_path / "grains.csv").write_text("\n".join(["x [mm],y [mm],z [mm]", *rows]))
    shutil.copy(pathlib.Path(__file__).parents[2] / "toy" / "tetrahedron.obj", tmp_path)
    monkeypatch.chdir(tmp_path)


Path = tuple[str | int, ...]


def quantities(data: Any, place: Path = ()) -> Iterator[tuple[Path, str, str]]:
    """Place, dotted key and SI unit of all texts in `data` that are quantities with a unit."""
    if isinstance(data, Mapping):
        for key, inner in data.items():
            yield from quantities(inner, (*place, key))
    elif isinstance(data, list):
        for index, inner in enumerate(data):
            yield from quantities(inner, (*place, index))
    elif isinstance(data, str):
        shape = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")
        units = {key.unit for name in (shape, re.sub(r"(\[\d+\])+$", "", shape)) for key in find(name) if key.unit}
        if units:
            (unit,) = units
            yield place, shape, unit


def put(data: Any, place: Path, value: Any) -> Any:
    """`data` with `value` at a place."""
    if not place:
        return value
    head, *rest = place
    if isinstance(data, list):
        return [put(inner, tuple(rest), value) if index == head else inner for index, inner in enumerate(data)]
    return {**data, head: put(data[head], tuple(rest), value)}


def resolved(data: Mapping[str, Any]) -> list[Any]:
    """All numbers and words of the study's only point, its window and its stop rule, in one order."""
    study = labbook.define(data, name="u")
    (point,) = study.points
    models = [point.scene, point.fill, point.numerics, study.window, study.stop, study.record]
    return [leaf for model in models if model is not None for leaf in leaves(model.model_dump())]


def leaves(data: Any) -> Iterator[Any]:
    if isinstance(data, Mapping):
        for key in data:
            yield from leaves(data[key])
    elif isinstance(data, list | tuple):
        for inner in data:
            yield from leaves(inner)
    else:
        yield data


def same(ours: list[Any], expected: list[Any]) -> bool:
    """To 1e-12: conversions have 15 digits, and some numbers are quotients of two."""
    return len(ours) == len(expected) and all(
        math.isclose(a, b, rel_tol=1e-12, abs_tol=1e-18) if isinstance(b, float) else a == b
        for a, b in zip(ours, expected, strict=True)
    )


PLACES = [(name, *found) for name, data in STUDIES.items() for found in quantities(data)]


def test_the_studies_have_every_key_with_a_unit():
    stated = {re.sub(r"\[\d+\]", "[]", key) for _, _, key, _ in PLACES}
    stated |= {re.sub(r"(\[\])+$", "", key) for key in stated}
    stated = {re.sub(r"^walls\.\w+", "walls.*", key) for key in stated}
    # a part that moves or vanishes is a mesh, whose file a study from Python has not: test_plan_moving_parts.py; zones
    # are in test_measure_velocities.py
    elsewhere = (".moves.", ".opens", ".zones[].")
    keys = {key.name for key in all_keys() if key.unit and not any(part in key.name for part in elsewhere)}
    assert not keys - stated
    assert {key.unit for key in all_keys() if key.unit} == {*SPELLINGS}


@pytest.mark.parametrize(("name", "place", "key", "unit"), PLACES, ids=[f"{p[0]}-{p[2]}" for p in PLACES])
def test_every_spelling_of_a_unit_is_the_same_physics(name, place, key, unit):
    data = STUDIES[name]
    stated: Any = data
    for part in place:
        stated = stated[part]
    number, expected = float(stated.split()[0]), resolved(data)
    for spelling, factor in SPELLINGS[unit].items():
        text = f"{number / factor!r} {spelling}"
        assert same(resolved(put(data, place, text)), expected), text


@pytest.mark.parametrize(("name", "place", "key", "unit"), PLACES, ids=[f"{p[0]}-{p[2]}" for p in PLACES])
def test_a_unit_of_another_dimension_is_refused(name, place, key, unit):
    for foreign in FOREIGN:
        if foreign not in SPELLINGS[unit]:
            with pytest.raises(StudyError, match=re.escape(key) + "|" + re.escape(re.sub(r"\[\d+\]$", "", key))):
                resolved(put(STUDIES[name], place, f"1 {foreign}"))


NUMBERS = [key for key in all_keys() if key.unit == "" and key.type == "quantity"]


@pytest.mark.parametrize("unit", ["rad", "deg", "°", "turn", "Hz", "1/s", "mm"])
def test_an_angle_is_no_plain_number(unit):
    assert {"contact.friction", "contact.restitution", "window.end"} <= {key.name for key in NUMBERS}
    with pytest.raises(ValueError, match="a number without unit is needed, not one in"):
        parse(f"0.5 {unit}", "")
    with pytest.raises(StudyError, match=r"contact\.friction: 0\.5 .*a number without unit is needed"):
        resolved(put(STUDIES["wedge"], ("contact", "friction"), f"0.5 {unit}"))


TURNS = ["1 Hz", "60 rpm", "1 turn/s", "1 rev/s", "60 rev/min", "360 deg/s", "1 s^-1", "60 1/min", "1e-3 kHz"]


def spin(study: labbook.Study, index: int = 0) -> float:
    """Angular velocity of the bottom [rad/s]."""
    walls = study.points[index].scene.container.walls()
    return next(wall for wall in walls if wall.name == "bottom").motion.spin


@pytest.mark.parametrize("turn", TURNS)
def test_one_turn_per_second_is_the_same_wherever_it_is_written(turn):
    """Exactly: the key of the scene is that of `rotation: 1 Hz`."""
    silo = {"name": "u", "grains": GRAINS, "contact": LINEAR, "container": CYLINDER}
    base = labbook.define(silo)
    assert spin(base) == 2 * math.pi
    number, unit = turn.split()
    studies = [
        labbook.define(put(silo, ("container", "rotation"), turn)),
        labbook.define(silo, sweep={"container.rotation": [turn]}),
        labbook.define(silo, sweep={"container.rotation": f"[{number}] {unit}"}),
        labbook.define(silo, sweep={"zip": {"container.rotation": [turn]}}),
        labbook.define(silo, points=[{"container.rotation": turn}]),
        base.change({"container.rotation": turn}),
    ]
    for study in studies:
        assert study.points[0].scene == base.points[0].scene, study.yaml()
    reference = {"source": "x", "flow_rate": {"at": {"container.rotation": turn}, "value": "1 g/s"}}
    (entry,) = labbook.define(silo, reference=reference).reference.entries  # pyright: ignore[reportOptionalMemberAccess]
    assert entry.at == {"container.rotation": 1.0}


def test_angular_velocities_of_a_frequency():
    silo = put(STUDIES["cylinder"], ("container", "rotation"), "6.283185307179586 rad/s")
    assert spin(labbook.define(silo, name="u")) == pytest.approx(2 * math.pi, rel=1e-14)


def test_points_keep_their_spelling_in_labels():
    study = labbook.define(
        name="u", grains=GRAINS, contact=LINEAR, container=CYLINDER, sweep={"container.rotation": "[0, 30, 60] rpm"}
    )
    assert [point.label for point in study.points] == ["rotation 0 rpm", "rotation 30 rpm", "rotation 60 rpm"]
    assert [point.at["container.rotation"] for point in study.points] == [0, 0.5, 1]
    assert [spin(study, index) for index in range(3)] == [0, math.pi, 2 * math.pi]


def test_radians_or_turns_have_to_be_said_of_an_angular_velocity():
    place = ("container", "parts", 1, "motion", "spin")
    with pytest.raises(StudyError, match=r"write 0\.5 rad/s, or 0\.5 Hz for turns per second"):
        resolved(put(STUDIES["walls"], place, "30 1/min"))
    with pytest.raises(StudyError, match="the unit is missing"):
        resolved(put(STUDIES["walls"], place, 3))
    with pytest.raises(StudyError, match="the unit is missing"):
        resolved(put(STUDIES["wedge"], ("container", "angle"), 30))
