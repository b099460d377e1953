"""How numbers are written."""

import math
from pathlib import Path

import pytest

import labbook
from labbook.report.setting import common
from labbook.results import display


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.055823, 0.00031, "0.05582 ± 0.00031"),
        (1.55, 0.025, "1.550 ± 0.025"),
        (123.456, 7.0, "123.5 ± 7.0"),
        (-0.0123, 0.001, "−0.0123 ± 0.0010"),
        (12.0, math.nan, "12"),
    ],
)
def test_a_value_has_the_digits_that_its_error_allows(value, error, text):
    assert display.with_error(value, error) == text


def test_ends_that_are_not_there_are_written_so():
    assert display.number(math.inf) == "∞"
    assert display.number(-math.inf) == "−∞"
    assert display.number(math.nan) == "–"


def test_settings_are_shown_in_the_units_of_the_field():
    assert display.setting("container.orifice", 0.0525) == "D = 52.5 mm"
    assert display.setting("container.angle", math.radians(55)) == "angle = 55 deg"
    assert display.setting("walls.all.friction", 0.01) == "friction of all walls = 0.01"
    assert display.setting("contact.rolling", "full") == "rolling = full"


def test_the_slope_is_scaled_to_grams_and_millimetres():
    # 1 kg^(2/3) s^(-2/3) m^-1 is (1000 g)^(2/3) / 1000 mm = 0.1 (g/s)^(2/3)/mm.
    assert display.quantity("beverloo.slope").scale == pytest.approx(1000 ** (2 / 3) / 1000)
    # 1 s^-1 m^-3/2 is (1000 mm)^-3/2.
    assert display.quantity("janda.C_prime").scale == pytest.approx(1000**-1.5)


def test_frictions_are_told_apart():
    keys = ("contact.friction", "fill.friction", "walls.all.friction", "walls.left.friction")
    names = [display.key(key).name for key in keys]
    assert names == ["friction", "friction while filling", "friction of all walls", "friction of wall left"]


def test_young_s_modulus_is_shown_as_it_was_stated():
    """E = 2 G (1 + nu) to 12 digits, also where Poisson's ratio varies and the shear modulus with it."""
    study = {
        "name": "x",
        "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 600},
        "contact": {"law": "hertz-mindlin", "youngs_modulus": "12 MPa", "poisson_ratio": 0.22, "restitution": 0.5},
        "container": {"kind": "cylinder-silo", "diameter": "40 mm", "height": "300 mm", "orifice": "20 mm"},
    }
    rows = dict(common(labbook.define(study).points))
    assert "Young's modulus 12 MPa, shear modulus 4.91803 MPa" in rows["Contact"]
    varied = labbook.define(study, sweep={"contact.poisson_ratio": [0.1, 0.22, 0.3, 0.45]})
    rows = dict(common(varied.points))
    assert "Young's modulus 12 MPa" in rows["Contact"]
    assert "shear modulus" not in rows["Contact"]
    swept = labbook.define(study, sweep={"contact.youngs_modulus": ["5 MPa", "12 MPa"]})
    assert "modulus" not in dict(common(swept.points))["Contact"]


def test_a_mesh_is_described_in_words_and_not_by_its_vertices(monkeypatch):
    monkeypatch.chdir(Path(__file__).parents[2] / "toy")
    insert = {"name": "insert", "shape": {"kind": "mesh", "file": "tetrahedron.obj", "unit": "mm", "at": ["0 mm"] * 3}}
    silo = {"kind": "box", "width": "5 cm", "depth": "5 cm", "height": "9 cm", "parts": [insert]}
    grains = {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 10}
    contact = {"law": "linear", "normal_stiffness": "1000 N/m", "restitution": 0.5, "friction": 0.3}
    study = labbook.define(name="x", grains=grains, contact=contact, container=silo, measure=["packing"])
    row = dict(common(study.points))["Container"]
    assert "4 triangles, closed, area 2.366 cm^2, 10 x 10 x 10 mm" in row
    assert "vertices" not in row
    assert len(row) < 1000
