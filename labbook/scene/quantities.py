"""Numbers with units: field types that read `3 mm` into 0.003 and refuse a length without a unit.

Everything behind these types is SI. From Python a plain float is taken as SI; from a study file (validation
context `units="required"`) a dimensional number must carry its unit. `d`, the grain diameter, is a unit of
length wherever the context names it (`d` -> diameter [m]).

An angle has a dimension of its own here: 30 deg is no plain number, and 1 rad/s is not 1 Hz. What turns may be stated
by its frequency (Hz, rpm, turn/s) or by its angular velocity (rad/s, deg/s), whichever of the two a key holds.
"""

import math
import re
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationInfo
from pydantic_core import PydanticCustomError


def _registry():
    with _setting_up:  # quantities of two registries do not go together
        return _made_registry()


@lru_cache(maxsize=1)
def _made_registry():
    import pint  # here, not above: building its registry takes longer than the rest of `import labbook`

    registry = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
    registry.define("@alias revolution = rev")
    return registry


_setting_up = threading.Lock()


_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?(\s*/\s*\d+\.?\d*)?(?![\d.])")
_TERM = re.compile(r"([A-Za-zµμΩ]+|[%°])(?:(?:\^|\*\*)(-?\d))?(\s*[*/]\s*|\s+|$)", re.ASCII)
_PER = re.compile(r"1?\s*/\s*")


class _TurnsOrAngles(ValueError):
    """Error of a rate that may be meant as turns or as radians per second; `rate`: of one of its unit [1/s]."""

    def __init__(self, rate: float):
        super().__init__("1/s may mean turns or radians per second")
        self.rate = rate


@lru_cache(maxsize=8192)  # of a study's many points most quantities are the same
def parse(text: str, unit: str | None, diameter: float | None = None) -> float:
    """Read a quantity: a number, or a ratio of two, and then units joined by blanks, * and /.

    Powers of units have one digit; there is no other arithmetic. A rate of turning is read as a frequency or as an
    angular velocity: 60 rpm is 1 Hz and 2 pi rad/s.

    Args:
        text: Quantity, such as `3 mm`, `2500 kg/m^3`, `2/7`, `1 %` or `1.01 d`.
        unit: SI unit of the result; "": a number without unit, None: the SI unit of the quantity.
        diameter: Length of the unit `d` [m]; None: `d` is unknown.

    Returns:
        Value in `unit`; it may be infinite.

    Raises:
        ValueError: The text is no quantity in `unit`; the message says why, with a remedy.
    """
    expression = text.strip()
    if len(expression) > 100:
        raise ValueError("not a quantity: it is too long")
    number = _NUMBER.match(expression)
    if number is None and not re.match(r"d\b", expression):
        raise ValueError("not a quantity: it does not begin with a number")
    value = _number(number.group()) if number else 1.0
    units = expression[number.end() if number else 0 :].strip().removeprefix("*").lstrip()
    try:
        factor = _factor(units, unit, diameter)
    except _TurnsOrAngles as error:
        rate = f"{value * error.rate:.12g}"
        raise ValueError(f"{error}: write {rate} rad/s, or {rate} Hz for turns per second") from None
    except ValueError as error:
        raise ValueError(f"{error}{_spelling_hint(units, unit, diameter)}") from None
    if not math.isfinite(value * factor):
        return value * factor
    # in decimals: 18 mm is 0.018, not 0.018000000000000002; keys hash these digits
    number, periods = Decimal(repr(value)), 1 / factor if unit == "Hz" and factor else 0.0
    if periods > 0.5 and math.isclose(periods, round(periods), rel_tol=1e-12):
        return float(number / Decimal(round(periods)))  # 60 rpm is 1 Hz, and not 1.000000000000002 Hz
    return float(number * Decimal(f"{factor:.15g}"))


def format_distinct(value: float, limit: float, digits: int = 3, of_limit: int = 6) -> tuple[str, str]:
    """Write a value beyond a limit and the limit so that a reader sees which is larger.

    Numbers from 1e-4 to 1e6 are written out.

    Args:
        value: Value.
        limit: Limit.
        digits: Significant digits of the value at least.
        of_limit: Significant digits of the limit at least.

    Returns:
        Both numbers as text, with as many more digits as tell them apart.
    """
    for extra in range(17):
        number, bound = f"{value:.{digits + extra}g}", f"{limit:.{of_limit + extra}g}"
        if (float(number) > float(bound), float(number) < float(bound)) == (value > limit, value < limit):
            break
    return _decimal(number), _decimal(bound)


def _decimal(number: str) -> str:
    """Write a number without an exponent (4.15e+03), unless it is large or small, or has many digits."""
    plain = f"{float(number):.6g}"
    return plain if "e" in number and float(plain) == float(number) else number


def value_range(values: Iterable[float], unit: str, scale: float = 1.0) -> str:
    """Write the range of values.

    Args:
        values: Values, at least one.
        unit: Unit, as text.
        scale: Factor on the values.

    Returns:
        `50 ms`, or `20 to 50 ms`.
    """
    numbers = [f"{scale * value:.3g}" for value in sorted(values)]
    return f"{' to '.join(dict.fromkeys((numbers[0], numbers[-1])))} {unit}"


_PERCENT_LIMIT = 1e3
"""Ratio from which on it is written as a multiple, not in percent."""


def percent(fraction: float, how: str = ".3g") -> str:
    """Write a fraction in percent.

    Args:
        fraction: Fraction.
        how: Format of the number of percent; an exponent that it gives (1.1e+02) is written out.

    Returns:
        `2 %`, `0.25 %` or `110 %`; above a hundred thousand percent `1e300 times`.
    """
    plus = "+" if how.startswith("+") else ""
    if _PERCENT_LIMIT <= abs(fraction) < math.inf:
        return re.sub(r"e(-?)\+?0*", r"e\1", f"{fraction:{plus}.3g} times")
    number = _decimal(f"{100 * fraction:{how}}")
    return f"{plus if number[0] not in '+-' else ''}{number} %"


_RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def span(seconds: float) -> str:
    """Write a simulated time [s] for people: 0.25 s, 12 ms, 2.5 us."""
    for unit, scale in (("s", 1.0), ("ms", 1e-3)):
        if abs(seconds) >= 0.1 * scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"


def _spelling_hint(units: str, unit: str | None, diameter: float | None) -> str:
    """Remedy for misspelt `units` (`kg/m3`, `kg/m³`, `kg/m^-3`); empty without one."""
    raised = re.sub(r"(?<=[A-Za-z])([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", lambda found: "^" + found[1].translate(_RAISED), units)
    raised = re.sub(r"(?<=[A-Za-z])(-?\d)", r"^\1", raised)
    for candidate in (raised, re.sub(r"(/\s*[A-Za-z]+\^)-(\d)", r"\1\2", raised)):
        try:
            _factor(candidate, unit, diameter)
        except ValueError:
            continue
        return f": write {candidate}" if candidate != units else ""
    return ""


def leading_number(text: str) -> tuple[str, float] | None:
    """Read the number that a quantity begins with.

    Args:
        text: Quantity.

    Returns:
        Number as text and as value; None if the text begins with none, or it divides by zero.
    """
    match = _NUMBER.match(text.strip())
    try:
        return None if match is None else (match.group(), _number(match.group()))
    except ValueError:
        return None


def without_noise(number: float) -> float:
    """Round off the noise of arithmetic behind a number of few digits.

    Args:
        number: Number, such as 0.30000000000000004.

    Returns:
        Number of few digits, such as 0.3; `number` itself if it has many, as a third has.
    """
    short = f"{number:.{DIGITS}g}"
    digits = short.partition("e")[0].lstrip("-0.").replace(".", "")
    return float(short) if len(digits) <= _FEW else number


def whole(value: Any) -> Any:
    """Make whole numbers of 1e4 and 1.0e+3, also of text, which YAML takes them for.

    Args:
        value: Value of a key.

    Returns:
        Whole number; `value` itself if it is none.
    """
    if isinstance(value, str) and (leading := leading_number(value)) is not None and leading[0] == value.strip():
        number = leading[1]
    else:
        number = value
    if isinstance(number, float) and abs(number) < 2**53 and number.is_integer():
        return int(number)
    return value


DIGITS, _FEW = 12, 9
"""Digits beyond which numbers differ by noise of an arithmetic, and those of numbers that somebody may have meant."""


def _number(text: str) -> float:
    numerator, _, denominator = text.partition("/")
    try:
        return float(numerator) / float(denominator or "1")
    except ZeroDivisionError:
        raise ValueError("division by zero") from None


_RATE = {"[time]": -1}
"""Dimension of turns and, to pint, of radians per time."""


@lru_cache(maxsize=4096)
def _factor(units: str, unit: str | None, diameter: float | None) -> float:
    """Value of one of `units` in `unit`, or in SI without it; ValueError if they do not fit."""
    if units == "":
        if unit:
            raise ValueError(f"the unit is missing: write it as a quantity in {unit}")
        return 1.0
    import pint

    registry = _registry()
    per = _PER.match(units)
    product, counts = registry.Quantity(1.0), False
    position, sign, link = (per.end(), -1, "/") if per else (0, 1, "")
    try:
        while position < len(units):
            term = _TERM.match(units, position)
            if term is None:
                raise ValueError("not a quantity: a number and then its unit are needed")
            name, power, link = term.groups()
            term_unit = _unit_quantity(name, diameter)
            counts |= term_unit.dimensionality == _RATE
            product = product * term_unit ** (sign * int(power or "1"))
            position, sign = term.end(), -1 if "/" in link else 1
        if sign < 0 or link.strip() == "*":
            raise ValueError("not a quantity: a unit is missing at its end")
        magnitude: Any = (product.to_base_units() if unit is None else _converted(product, unit, counts)).magnitude
        return float(magnitude)
    except pint.DimensionalityError as error:
        raise ValueError(_mismatch(registry.Unit(error.units1), unit)) from None
    except ArithmeticError:
        raise ValueError("not a quantity: out of range") from None


def _converted(product: Any, unit: str, counts: bool) -> Any:
    """Convert the pint quantity `product` (in base units) to `unit`.

    An angle is no number, which it is to pint, but a turn of 2 pi rad is what a frequency counts. `counts`: the product
    is of a unit such as Hz, and not only 1/s.
    """
    registry = _registry()
    target = registry.Quantity(1.0, unit or "dimensionless")
    angle, needed = (dict(amount.to_base_units().unit_items()).get("radian", 0) for amount in (product, target))
    if angle == needed or product.dimensionality != target.dimensionality:
        return product.to(target)
    rate = product.dimensionality == _RATE
    if rate and unit == "Hz" and angle == 1:
        return (product / registry.Quantity(1.0, "turn")).to(target)
    if rate and (angle, needed) == (0, 1):
        if not counts:
            raise _TurnsOrAngles(product.to("1/s").magnitude)
        return (product * registry.Quantity(1.0, "turn")).to(target)
    raise ValueError(_mismatch(product.units, unit))


def _mismatch(units: Any, unit: str | None) -> str:
    """Reason against the pint unit `units` in place of `unit`."""
    requirement, symbol = f"a quantity in {unit}" if unit else "a number without unit", f"{units:~}"
    return f"{requirement} is needed, not {f'one in {symbol}' if symbol else 'a number without unit'}"


def _unit_quantity(name: str, diameter: float | None):
    """Quantity of pint in base units: one of the unit `name`."""
    import pint

    registry = _registry()
    if name == "d":
        if diameter is None:
            raise ValueError("the unit d (grain diameter) cannot be used here")
        return registry.Quantity(diameter, "meter")
    name = {"%": "percent", "°": "degree"}.get(name, name)
    try:
        zero, single = (registry.Quantity(number, name).to_base_units() for number in (0.0, 1.0))
    except (pint.PintError, ArithmeticError, AttributeError, TypeError, ValueError):
        raise ValueError(f"unknown unit {name}") from None
    if zero.magnitude != 0:
        raise ValueError(f"{name} is a scale with an offset: use an absolute unit")
    return single


@dataclass(frozen=True)
class Unit:
    """Mark of a field as a quantity in `symbol` (SI), for tools that read or write studies."""

    symbol: str

    def __call__(self, value: Any, info: ValidationInfo) -> Any:
        context = info.context or {}
        if isinstance(value, str):
            try:
                number = parse(value, self.symbol, self._diameter(info))
            except ValueError as error:
                raise self._error("bad_quantity", str(error)) from None
        elif isinstance(value, bool) or not isinstance(value, int | float):
            raise self._error("not_a_quantity", self._requirement)
        elif self.symbol and context.get("units") == "required":
            raise self._error("missing_unit", f"the unit is missing: a quantity in {self.symbol} is needed")
        else:
            number = float(value) if abs(value) <= 1e308 else math.inf
        if not math.isfinite(number):
            raise self._error("not_finite", "a finite number is needed")
        return without_noise(number) if context.get("units") == "required" else number

    def _diameter(self, info: ValidationInfo) -> float | None:
        """Length of the unit `d` [m]."""
        return (info.context or {}).get("d")

    @property
    def _requirement(self) -> str:
        return f"a quantity in {self.symbol} is needed" if self.symbol else "a number without unit is needed"

    def _error(self, kind: str, reason: str) -> PydanticCustomError:
        # as a field of the context: the message is a template, and units may hold braces
        return PydanticCustomError(kind, "{reason}", {"reason": reason, "unit": self.symbol})  # pyright: ignore[reportArgumentType]


class OfGrain(Unit):
    """Mark of a quantity of the grains themselves: its `d` is the `diameter` that stands before it."""

    def _diameter(self, info: ValidationInfo) -> float | None:
        return info.data.get("diameter")


def quantity(symbol: str) -> tuple[Unit, BeforeValidator]:
    """Make the pair of annotations of a float field that is a quantity in `symbol`."""
    unit = Unit(symbol)
    return unit, BeforeValidator(unit)


_m, _m_ = quantity("m")
_own = OfGrain("m")
_rad, _rad_ = quantity("rad")
_rho, _rho_ = quantity("kg/m^3")
_pa, _pa_ = quantity("Pa")
_plain, _plain_ = quantity("")
_g, _g_ = quantity("m/s^2")
_s, _s_ = quantity("s")
_npm, _npm_ = quantity("N/m")
_hz, _hz_ = quantity("Hz")
_v, _v_ = quantity("m/s")
_w, _w_ = quantity("rad/s")
_flow, _flow_ = quantity("kg/s")

_whole_ = BeforeValidator(whole)

_LISTED = re.compile(r"\s*\[(.*)\]\s*(.*?)\s*", re.DOTALL)


def _listed(value: Any) -> Any:
    """Items of a list in quotes, each with the unit that follows the list."""
    match = _LISTED.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        return value
    body, unit = match.groups()
    return [f"{item.strip()} {unit}".strip() for item in body.split(",")] if body.strip() else []


listed = BeforeValidator(_listed)
"""Mark of a field of several quantities that a study may write as `[1, 2, 3] mm` in quotes."""

# Limits keep every product of these finite; no granular matter lies near them.
Length = Annotated[float, _m, _m_, Field(ge=1e-9, le=1e6)]
GrainLength = Annotated[float, _own, BeforeValidator(_own), Field(ge=1e-9, le=1e6)]
_GrainCoordinate = Annotated[float, _own, BeforeValidator(_own), Field(ge=-1e6, le=1e6)]
GrainPoint = Annotated[tuple[_GrainCoordinate, _GrainCoordinate, _GrainCoordinate], listed]
Coordinate = Annotated[float, _m, _m_, Field(ge=-1e9, le=1e9)]
Distance = Annotated[float, _m, _m_, Field(ge=0, le=1e6)]
Angle = Annotated[float, _rad, _rad_, Field(ge=-1e3, le=1e3)]
Density = Annotated[float, _rho, _rho_, Field(ge=1e-6, le=1e9)]
Pressure = Annotated[float, _pa, _pa_, Field(ge=1e-3, le=1e15)]
Stiffness = Annotated[float, _npm, _npm_, Field(ge=1e-9, le=1e15)]
Acceleration = Annotated[float, _g, _g_, Field(ge=0, le=1e9)]
Duration = Annotated[float, _s, _s_, Field(ge=1e-15, le=1e9)]
Instant = Annotated[float, _s, _s_, Field(ge=0, le=1e9)]
Frequency = Annotated[float, _hz, _hz_, Field(ge=-1e9, le=1e9)]
Speed = Annotated[float, _v, _v_, Field(ge=-1e8, le=1e8)]
AngularSpeed = Annotated[float, _w, _w_, Field(ge=-1e9, le=1e9)]
MassRate = Annotated[float, _flow, _flow_, Field(ge=1e-18, le=1e12)]
Ratio = Annotated[float, _plain, _plain_, Field(ge=-1e6, le=1e6)]
Coefficient = Annotated[float, _plain, _plain_, Field(ge=0, le=1e6)]
Whole = Annotated[int, Field(strict=True), _whole_]


def duration(seconds: float) -> str:
    """Write a time span [s] for people, to two figures or so: 40 s, 12 min, 3.5 h, 2.1 d."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 90 * 60:
        return f"{seconds / 60:.0f} min"
    if seconds < 48 * 3600:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 86400:.1f} d"


def size(count: float) -> str:
    """Write a number of bytes for people: 40 kB, 1.2 MB, 3.5 GB."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= scale:
            return f"{count / scale:.1f} {unit}"
    return f"{count:.0f} B"
