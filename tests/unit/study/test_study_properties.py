"""Garbage in, problems out: a study file is a study, or a StudyError that says what to do. Never a traceback."""

import copy
import io
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from labbook.study import Study, StudyError, load

STUDIES = Path(__file__).parents[3] / "studies"
QUICK = settings(max_examples=80)


def check(raw: bytes) -> Study | StudyError:
    """What must hold of any file whatever."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "study.yaml"
        file.write_bytes(raw)
        try:
            result = load(file)
        except StudyError as error:
            result = error
    if isinstance(result, StudyError):
        assert result.problems
        for problem in result.problems:
            assert problem.file == file
            assert problem.line >= 0
            assert problem.line or problem.key
            assert problem.message
            assert problem.remedy
            assert "\n" not in problem.message
            assert str(problem) in str(result)
        return result
    assert result.points
    for point in result.points:
        assert point.numerics.dt > 0
        assert point.scene.close().container.closed  # pyright: ignore[reportAttributeAccessIssue]
    return result


def dumped(data: Any) -> bytes:
    stream = io.BytesIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.dump(data, stream)
    return stream.getvalue()


def valid() -> dict[str, Any]:
    """A study that uses most of what there is."""
    sphere = {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 300}
    law = {"law": "hertz-mindlin", "shear_modulus": "5 MPa", "poisson_ratio": 0.25, "friction": 0.5}
    hopper = {"kind": "wedge-hopper", "width": "60 mm", "height": "200 mm", "thickness": "1.01 d", "orifice": "24 mm"}
    return {
        "name": "whole",
        "about": "everything",
        "grains": sphere,
        "contact": {**law, "restitution": 0.2},
        "container": hopper,
        "walls": {"all": {"friction": 0.1}},
        "gravity": "9.81 m/s^2",
        "sweep": {
            "container.angle": "[60, 90] deg",
            "zip": {"container.gap": ["0 mm", "6 mm"], "contact.friction": [0.1, 0.5]},
        },
        "points": [{"container.orifice": "18 mm"}, {"container.orifice": "24 mm"}],
        "replicates": 2,
        "accuracy": {"flow_rate": "1 %", "max_replicates": 4},
        "numerics": {"dt": "0.1 rayleigh", "skin": 0.1},
        "fill": {"friction": 0.01},
        "measure": ["flow_rate", "packing"],
        "fit": ["beverloo"],
        "window": {"start": 0.2, "end": 0.5},
        "stop": {"discharged": 0.6, "stall": "1 s"},
        "record": {"every": "10 ms", "replicates": 1},
        "reference": {"source": "x", "beverloo.k": {"at": {"container.angle": "90 deg"}, "value": 1.5, "error": 0.1}},
    }


def places(data: Any, here: tuple = ()) -> list[tuple]:
    """Where there is something that can be changed."""
    inner = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [place for key, value in inner for place in ((*here, key), *places(value, (*here, key)))]


PLACES = places(valid())

garbage = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.integers(min_value=10**300, max_value=10**330),
    st.floats(),
    st.text(max_size=12),
    st.builds(
        lambda x, unit: f"{x} {unit}", st.floats(), st.sampled_from(["mm", "kg", "d", "deg", "s", "%", "rayleigh"])
    ),
    st.sampled_from(
        ["1e-320 m", "1e308 kg/m^3", "-0.0 mm", "[1, 2] mm", "[] mm", "[,] mm", "1/3 m", "²", "3 d", "*", "&a", "{}"]
    ),
    st.lists(st.integers() | st.text(max_size=5), max_size=4),
    st.dictionaries(st.text(max_size=8), st.integers() | st.text(max_size=5), max_size=3),
)


def test_the_starting_point_is_a_study():
    assert isinstance(check(dumped(valid())), Study)


@QUICK
@given(st.binary(max_size=200))
def test_any_bytes(raw):
    check(raw)


@QUICK
@given(st.text(st.sampled_from("abcxyz019 :-[]{}&*!|>'\"#%@`,?\n\t~."), max_size=120))
def test_text_that_looks_like_yaml(text):
    check(text.encode())


@pytest.mark.slow
@QUICK
@given(st.data())
def test_a_value_replaced(data):
    study = valid()
    changes = data.draw(st.lists(st.tuples(st.sampled_from(PLACES), garbage), min_size=1, max_size=2))
    for place, value in changes:
        inner: Any = study
        for key in place[:-1]:
            inner = inner[key] if isinstance(inner, dict) and key in inner else None
            if not isinstance(inner, dict):
                break
        if isinstance(inner, dict):
            inner[place[-1]] = value
    check(dumped(study))


@pytest.mark.slow
@QUICK
@given(st.sampled_from(PLACES), st.text(min_size=1, max_size=12), st.sampled_from(["rename", "delete", "add"]))
@example(("walls", "all"), "\n", "rename")
def test_a_key_renamed_deleted_or_added(place, name, change):
    study = valid()
    inner: Any = study
    for key in place[:-1]:
        inner = inner[key]
    if isinstance(inner, list):
        del inner[place[-1]]
    elif change == "add":
        inner[name] = copy.deepcopy(inner[place[-1]])
    else:
        value = inner.pop(place[-1])
        if change == "rename":
            inner[name] = value
    check(dumped(study))


@QUICK
@given(st.integers(0, 10_000), st.integers(0, 10_000), st.sampled_from(["cut", "double", "swap"]))
def test_lines_and_letters_of_a_real_study_moved(first, second, change):
    text = (STUDIES / "quickstart.yaml").read_text()
    lines = text.splitlines()
    i, j = first % len(lines), second % len(text)
    if change == "cut":
        text = text[:j] + text[j + 1 + first % 20 :]
    elif change == "double":
        text = "\n".join([*lines[: i + 1], *lines[i:]])
    else:
        k = second % len(lines)
        lines[i], lines[k] = lines[k], lines[i]
        text = "\n".join(lines)
    check(text.encode())


@pytest.mark.slow
@QUICK
@given(
    st.sampled_from(
        ["grains.diameter", "grains.density", "contact.shear_modulus", "container.width", "container.height"]
    ),
    st.floats(min_value=-320, max_value=308),
    st.sampled_from(["mm", "kg/m^3", "Pa", "m"]),
)
def test_huge_and_tiny_numbers(key, exponent, unit):
    section, leaf = key.split(".")
    study = valid()
    study[section][leaf] = f"{10.0**exponent!r} {unit}"
    check(dumped(study))


@pytest.mark.parametrize(("open_", "close"), [("[", "]"), ("{a: ", "}")])
@pytest.mark.parametrize("depth", [10, 100, 1000])
def test_deep_nesting(open_, close, depth):
    error = check(b"name: " + (open_ * depth + close * depth).encode())
    assert isinstance(error, StudyError)
