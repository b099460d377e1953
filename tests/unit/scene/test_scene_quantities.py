"""Quantities: numbers with units, and what is refused."""

import math
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labbook.scene.quantities import format_distinct, parse, percent


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("3 mm", "m", 0.003),
        ("3mm", "m", 0.003),
        ("+1.5e2 um", "m", 1.5e-4),
        ("2500 kg/m^3", "kg/m^3", 2500.0),
        ("2.5 g/cm**3", "kg/m^3", 2500.0),
        ("9.81 m s^-2", "m/s^2", 9.81),
        ("90 deg", "rad", math.pi / 2),
        ("90°", "rad", math.pi / 2),
        ("2.5 us", "s", 2.5e-6),
        ("2.5 µs", "s", 2.5e-6),
        ("100 MPa", "Pa", 1e8),
        ("1 %", "", 0.01),
        ("2/7", "", 2 / 7),
        ("1.01 d", "m", 0.00303),
        ("d", "m", 0.003),
        ("6*d", "m", 0.018),
        ("10 d/s", "m/s", 0.03),
        ("12 g/s", "kg/s", 0.012),
        ("12 g/s", None, 0.012),
    ],
)
def test_reads_units(text, unit, value):
    assert parse(text, unit, diameter=0.003) == pytest.approx(value, rel=1e-14)


def test_decimal_values_keep_their_digits():
    """18 * 0.001 is 0.018000000000000002 in floating point; keys hash digits, so that must not show."""
    for number in (18, 21, 24, 30, 36, 45, 52.5, 60):
        assert parse(f"{number} mm", "m") == float(f"{number}e-3")


@pytest.mark.parametrize(
    ("text", "unit", "reason"),
    [
        ("3", "m", "unit is missing"),
        ("3 kg", "m", "a quantity in m is needed, not one in kg"),
        ("3 mm", "", "a number without unit"),
        ("3 foo", "m", "unknown unit foo"),
        ("3 degC", "K", "a scale with an offset"),
        ("mm", "m", "does not begin with a number"),
        ("", "m", "does not begin with a number"),
        ("3 mm)", "m", "a number and then its unit"),
        ("3 m/", "m", "a unit is missing at its end"),
        ("1/0 m", "m", "division by zero"),
        ("9^9^9^9", "", "a number and then its unit"),
        ("9 m^99999999", "m", "a number and then its unit"),
        ("__import__('os')", "m", "does not begin with a number"),
        ("3 " + "m" * 200, "m", "too long"),
    ],
)
def test_refuses(text, unit, reason):
    with pytest.raises(ValueError, match=reason.replace("(", r"\(")):
        parse(text, unit)


def test_diameter_is_a_unit_only_where_there_are_grains():
    with pytest.raises(ValueError, match="grain diameter"):
        parse("1.01 d", "m")


@settings(max_examples=300)
@given(st.text(max_size=40), st.sampled_from(["m", "rad", "", "kg/m^3", None]))
def test_any_text_is_a_number_or_refused(text, unit):
    try:
        value = parse(text, unit, 0.003)
    except ValueError as error:
        value = float(bool(str(error)))
    assert isinstance(value, float)


@settings(max_examples=200)
@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e100, max_value=1e100))
def test_numbers_survive(number):
    assert parse(repr(number), "") == pytest.approx(number, rel=1e-15)
    assert parse(f"{number!r} mm", "m") == pytest.approx(number / 1000, rel=1e-14)


def test_a_value_beyond_a_limit_is_told_apart_from_it():
    assert format_distinct(0.0123456, 0.004) == ("0.0123", "0.004")
    assert format_distinct(4150.2, 200.0) == ("4150", "200")
    assert format_distinct(0.00400049, 0.004) == ("0.0040005", "0.004")
    assert format_distinct(4.996, 5, digits=2) == ("4.996", "5")
    assert format_distinct(33.64, 33.6, of_limit=3) == ("33.64", "33.6")
    assert format_distinct(0.004, 0.004) == ("0.004", "0.004")


@given(st.floats(1e-12, 1e12), st.floats(-1e-6, 1e-6))
def test_what_is_told_of_a_value_beyond_a_limit_has_their_order(limit, more):
    value = limit * (1 + more)
    shown, bound = map(float, format_distinct(value, limit))
    assert (shown > bound, shown < bound) == (value > limit, value < limit)


@pytest.mark.parametrize(
    ("part", "how", "shown"),
    [
        (0.02, ".3g", "2 %"),
        (0.0025, ".3g", "0.25 %"),
        (1.1, ".2g", "110 %"),
        (1e-4, ".2g", "0.01 %"),
        (99.96, ".2g", "10000 %"),
        (-1.234, "+.2g", "-120 %"),
        (1.234, "+.2g", "+120 %"),
        (0.123, "+.2f", "+12.30 %"),
        (0.655, ".0f", "66 %"),
        (1e300, "+.1f", "+1e300 times"),
        (-2.5e7, ".3g", "-2.5e7 times"),
        (1010, "+.1f", "+1.01e3 times"),
        (math.inf, ".3g", "inf %"),
    ],
)
def test_percentages_have_a_space_and_no_exponent(part, how, shown):
    assert percent(part, how) == shown


def test_all_percentages_are_written_so():
    """Python's own format has no space before the sign."""
    root = Path(__file__).parents[3]
    sources = [path for folder in ("labbook", "web", "backends") for path in (root / folder).rglob("*.py")]
    assert len(sources) > 200
    assert not [path for path in sources if re.search(r":[^{}\s]*%\}", path.read_text(encoding="utf-8"))]
