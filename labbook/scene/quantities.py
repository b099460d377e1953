"""Numbers with units: field types that read `3 mm` into 0.003 and refuse a length without a unit.

Everything behind these types is SI. From Python a plain float is taken as SI; from a study file (validation
context `units="required"`) a dimensional number must carry its unit. `d`, the grain diameter, is a unit of
length wherever the context names it (`d` -> diameter [m]).
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

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


_setting_up = threading.Lock()


_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?(\s*/\s*\d+\.?\d*)?(?![\d.])")
_TERM = re.compile(r"([A-Za-zµμΩ]+|[%°])(?:(?:\^|\*\*)(-?\d))?(\s*[*/]\s*|\s+|$)", re.ASCII)


@lru_cache(maxsize=8192)  # of a study's many points most quantities are the same
def parse(text: str, unit: str | None, diameter: float | None = None) -> float:
    """Value of `text` (`3 mm`, `2500 kg/m^3`, `2/7`, `1 %`, `1.01 d`) in `unit` (SI); `d` is `diameter` [m].

    `unit` "" is a number without unit, None takes any unit and gives SI. A number, or a ratio of two, and then
    units joined by blanks, * and /, with powers of one digit: no other arithmetic. Raises ValueError saying what
    is wrong.
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
    except ValueError as error:
        raise ValueError(f"{error}{_meant(units, unit, diameter)}") from None
    if not math.isfinite(value * factor):
        return value * factor
    # in decimals: 18 mm is 0.018, not 0.018000000000000002; keys hash these digits
    return float(Decimal(repr(value)) * Decimal(f"{factor:.15g}"))


def told_apart(value: float, limit: float, digits: int = 3, of_limit: int = 6) -> tuple[str, str]:
    """A value beyond a limit, and the limit, for a message: to `digits` and `of_limit` significant digits, or to as
    many more as show which of them is larger. Numbers from 1e-4 to 1e6 are written out."""
    for more in range(17):
        shown, bound = f"{value:.{digits + more}g}", f"{limit:.{of_limit + more}g}"
        if (float(shown) > float(bound), float(shown) < float(bound)) == (value > limit, value < limit):
            break
    return _written_out(shown), _written_out(bound)


def _written_out(number: str) -> str:
    """Without an exponent (4.15e+03), unless it is large or small, or has many digits."""
    plain = f"{float(number):.6g}"
    return plain if "e" in number and float(plain) == float(number) else number


def span(values: Iterable[float], unit: str, scale: float = 1.0) -> str:
    """The range of some values, times `scale`, in `unit`: `50 ms`, or `20 to 50 ms`."""
    shown = [f"{scale * value:.3g}" for value in sorted(values)]
    return f"{' to '.join(dict.fromkeys((shown[0], shown[-1])))} {unit}"


def percent(part: float, how: str = ".3g") -> str:
    """`2 %`, `0.25 %`, `110 %` of a part of one. `how`: to format the number of percent; where that gives an exponent
    (1.1e+02), the digits are written out."""
    number = _written_out(f"{100 * part:{how}}")
    return f"{'+' if how.startswith('+') and number[0] not in '+-' else ''}{number} %"


_RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def _meant(units: str, unit: str | None, diameter: float | None) -> str:
    """What `units` seem to be a misspelling of (`kg/m3`, `kg/m³`, `kg/m^-3`), as a remedy; empty if of nothing."""
    raised = re.sub(r"(?<=[A-Za-z])([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", lambda found: "^" + found[1].translate(_RAISED), units)
    raised = re.sub(r"(?<=[A-Za-z])(-?\d)", r"^\1", raised)
    for candidate in (raised, re.sub(r"(/\s*[A-Za-z]+\^)-(\d)", r"\1\2", raised)):
        try:
            _factor(candidate, unit, diameter)
        except ValueError:
            continue
        return f": write {candidate}" if candidate != units else ""
    return ""


def _number(text: str) -> float:
    numerator, _, denominator = text.partition("/")
    try:
        return float(numerator) / float(denominator or "1")
    except ZeroDivisionError:
        raise ValueError("division by zero") from None


@lru_cache(maxsize=4096)
def _factor(units: str, unit: str | None, diameter: float | None) -> float:
    """How many `unit` (SI; None: whatever it is in SI) one of `units` is. Raises ValueError."""
    if units == "":
        if unit:
            raise ValueError(f"the unit is missing: write it as a quantity in {unit}")
        return 1.0
    import pint

    registry = _registry()
    product, position, sign = registry.Quantity(1.0), 0, 1
    try:
        while position < len(units):
            term = _TERM.match(units, position)
            if term is None:
                raise ValueError("not a quantity: a number and then its unit are needed")
            name, power, link = term.groups()
            product = product * _one_of(name, diameter) ** (sign * int(power or "1"))
            position, sign = term.end(), -1 if "/" in link else 1
        if sign < 0 or link.strip() == "*":
            raise ValueError("not a quantity: a unit is missing at its end")
        magnitude: Any = (product.to_base_units() if unit is None else product.to(unit or "dimensionless")).magnitude
        return float(magnitude)
    except pint.DimensionalityError as error:
        wanted = f"a quantity in {unit}" if unit else "a number without unit"
        given = registry.Unit(error.units1)
        stated = "a number without unit" if given.dimensionless else f"one in {given:~}"
        raise ValueError(f"{wanted} is needed, not {stated}") from None
    except ArithmeticError:
        raise ValueError("not a quantity: out of range") from None


def _one_of(name: str, diameter: float | None):
    """One of the unit `name`, as a pint quantity in base units."""
    import pint

    registry = _registry()
    if name == "d":
        if diameter is None:
            raise ValueError("the unit d (grain diameter) cannot be used here")
        return registry.Quantity(diameter, "meter")
    name = {"%": "percent", "°": "degree"}.get(name, name)
    try:
        zero, one = (registry.Quantity(number, name).to_base_units() for number in (0.0, 1.0))
    except (pint.PintError, ArithmeticError, AttributeError, TypeError, ValueError):
        raise ValueError(f"unknown unit {name}") from None
    if zero.magnitude != 0:
        raise ValueError(f"{name} is a scale with an offset: use an absolute unit")
    return one


@dataclass(frozen=True)
class Unit:
    """Marks a field as a quantity in `symbol` (SI); found by tools that read or write studies."""

    symbol: str

    def __call__(self, value: Any, info: ValidationInfo) -> Any:
        context = info.context or {}
        if isinstance(value, str):
            try:
                number = parse(value, self.symbol, self._diameter(info))
            except ValueError as error:
                raise self._error("bad_quantity", str(error)) from None
        elif isinstance(value, bool) or not isinstance(value, int | float):
            raise self._error("not_a_quantity", self._wanted)
        elif self.symbol and context.get("units") == "required":
            raise self._error("missing_unit", f"the unit is missing: a quantity in {self.symbol} is needed")
        else:
            number = float(value) if abs(value) <= 1e308 else math.inf
        if not math.isfinite(number):
            raise self._error("not_finite", "a finite number is needed")
        return number

    def _diameter(self, info: ValidationInfo) -> float | None:
        """What the unit `d` comes to [m]."""
        return (info.context or {}).get("d")

    @property
    def _wanted(self) -> str:
        return f"a quantity in {self.symbol} is needed" if self.symbol else "a number without unit is needed"

    def _error(self, kind: str, reason: str) -> PydanticCustomError:
        # as a field of the context: the message is a template, and units may hold braces
        return PydanticCustomError(kind, "{reason}", {"reason": reason, "unit": self.symbol})  # pyright: ignore[reportArgumentType]


class OfGrain(Unit):
    """Marks a quantity of the grains themselves: its `d` is the `diameter` that stands before it."""

    def _diameter(self, info: ValidationInfo) -> float | None:
        return info.data.get("diameter")


def quantity(symbol: str) -> tuple[Unit, BeforeValidator]:
    """The pair of annotations that makes a float field a quantity in `symbol`."""
    unit = Unit(symbol)
    return unit, BeforeValidator(unit)


_m, _m_ = quantity("m")
_own = OfGrain("m")
_rad, _rad_ = quantity("rad")
_rho, _rho_ = quantity("kg/m^3")
_pa, _pa_ = quantity("Pa")
_one, _one_ = quantity("")
_g, _g_ = quantity("m/s^2")
_s, _s_ = quantity("s")
_npm, _npm_ = quantity("N/m")
_hz, _hz_ = quantity("Hz")
_v, _v_ = quantity("m/s")
_w, _w_ = quantity("rad/s")

# Limits keep every product of these finite; no granular matter lies near them.
Length = Annotated[float, _m, _m_, Field(ge=1e-9, le=1e6)]
GrainLength = Annotated[float, _own, BeforeValidator(_own), Field(ge=1e-9, le=1e6)]
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
Ratio = Annotated[float, _one, _one_, Field(ge=-1e6, le=1e6)]
Coefficient = Annotated[float, _one, _one_, Field(ge=0, le=1e6)]
