"""Numbers with units: field types that read `3 mm` into 0.003 and refuse a length without a unit.

Everything behind these types is SI. From Python a plain float is taken as SI; from a study file (validation
context `units="required"`) a dimensional number must carry its unit. `d`, the grain diameter, is a unit of
length wherever the context names it (`d` -> diameter [m]).
"""

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationInfo
from pydantic_core import PydanticCustomError


@lru_cache(maxsize=1)
def _registry():
    import pint  # here, not above: building its registry takes longer than the rest of `import labbook`

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


# A bare `d` as a unit: `1.01 d`, `d`, `6*d`, but not the d of `mm/d` spelled `day` or of `deg`.
_DIAMETER = re.compile(r"(?<![A-Za-z_])d(?![A-Za-z_0-9])")


def parse(text: str, unit: str, diameter: float | None = None) -> float:
    """Value of `text` in `unit` (SI); `d` in it stands for `diameter` [m]. Raises ValueError saying what is wrong."""
    import pint

    registry = _registry()
    expression = text.strip()
    if len(expression) > 200:
        raise ValueError("a quantity this long cannot be meant")
    if "**" in expression and re.search(r"\*\*\s*\(?\s*[-+]?\d{2,}", expression):
        raise ValueError("exponent out of range")
    if _DIAMETER.search(expression):
        if diameter is None:
            raise ValueError("the unit d (grain diameter) cannot be used here")
        expression = _DIAMETER.sub(f"({diameter!r} * m)", expression)
        expression = re.sub(r"(?<=[0-9.])\s*\(", " * (", expression)
    try:
        quantity = registry.Quantity(expression) if not expression.endswith("%") else _percent(expression)
        value = quantity.to(unit or "dimensionless").magnitude
    except pint.DimensionalityError as error:
        raise ValueError(_wrong_unit(error, unit)) from None
    except pint.UndefinedUnitError as error:
        raise ValueError(f"unknown unit {', '.join(map(str, _names(error)))}") from None
    except Exception as error:
        raise ValueError(f"not a quantity: {type(error).__name__}") from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("not a single real number")
    return float(f"{value:.16g}")  # 2.5 us is 2.5e-06, not 2.4999999999999998e-06: keys hash these digits


def _percent(expression: str):
    return _registry().Quantity(float(expression[:-1]) / 100.0, "dimensionless")


def _names(error) -> list[str]:
    names = error.unit_names
    return [names] if isinstance(names, str) else list(names)


def _wrong_unit(error, unit: str) -> str:
    if str(error.units1) == "dimensionless":
        return f"the unit is missing: write it as a quantity in {unit}"
    return f"a quantity in {unit or 'no unit'} is needed, not in {error.units1}"


@dataclass(frozen=True)
class Unit:
    """Marks a field as a quantity in `symbol` (SI); found by tools that read or write studies."""

    symbol: str

    def __call__(self, value: Any, info: ValidationInfo) -> Any:
        context = info.context or {}
        if isinstance(value, bool) or value is None:
            raise PydanticCustomError("not_a_quantity", "a quantity in {unit} is needed", {"unit": self.symbol or "1"})
        if isinstance(value, str):
            try:
                number = parse(value, self.symbol, context.get("d"))
            except ValueError as error:
                raise PydanticCustomError(
                    "bad_quantity", "{reason}", {"reason": str(error), "unit": self.symbol or "1", "text": value}
                ) from None
        elif isinstance(value, int | float):
            if self.symbol and context.get("units") == "required":
                raise PydanticCustomError(
                    "missing_unit",
                    "the unit is missing: write {value} with a unit of {unit}",
                    {"value": str(value), "unit": self.symbol},
                )
            try:
                number = float(value)
            except OverflowError:
                number = math.inf
        else:
            raise PydanticCustomError("not_a_quantity", "a quantity in {unit} is needed", {"unit": self.symbol or "1"})
        if not math.isfinite(number):
            raise PydanticCustomError("not_finite", "a finite number is needed", {})
        return number


def quantity(symbol: str) -> tuple[Unit, BeforeValidator]:
    """The pair of annotations that makes a float field a quantity in `symbol`."""
    unit = Unit(symbol)
    return unit, BeforeValidator(unit)


_m, _m_ = quantity("m")
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

Length = Annotated[float, _m, _m_, Field(gt=0, le=1e6)]
Coordinate = Annotated[float, _m, _m_]
Distance = Annotated[float, _m, _m_, Field(ge=0)]
Angle = Annotated[float, _rad, _rad_]
Density = Annotated[float, _rho, _rho_, Field(gt=0)]
Pressure = Annotated[float, _pa, _pa_, Field(gt=0)]
Stiffness = Annotated[float, _npm, _npm_, Field(gt=0)]
Acceleration = Annotated[float, _g, _g_, Field(ge=0)]
Duration = Annotated[float, _s, _s_, Field(gt=0)]
Frequency = Annotated[float, _hz, _hz_]
Speed = Annotated[float, _v, _v_]
AngularSpeed = Annotated[float, _w, _w_]
Ratio = Annotated[float, _one, _one_]
Coefficient = Annotated[float, _one, _one_, Field(ge=0)]
