"""Numbers and keys as people read them: millimetres, degrees, g/s; no more digits than the error allows."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cache

from labbook.fit import LAWS
from labbook.measure import MEASURES
from labbook.measure.recorded import FlowPattern
from labbook.measure.regime import FlowRegime
from labbook.scene.quantities import percent
from labbook.stats import Pooled
from labbook.study.paper import PAPERS


@dataclass(frozen=True)
class Notation:
    """Notation of a quantity on pages, in tables and in figures.

    Args:
        name: Symbol or name.
        unit: Displayed unit; empty for a pure number.
        scale: Factor from SI to the displayed unit.
        about_zero: True if a value that agrees with zero is a result, as of a difference.
    """

    name: str
    unit: str = ""
    scale: float = 1.0
    about_zero: bool = False

    @property
    def heading(self) -> str:
        """Name with its unit, as on an axis or above a column."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


_MM, _DEGREE = 1e3, 180 / math.pi

KEYS = {
    "container.orifice": Notation("D", "mm", _MM),
    "container.lip.radius": Notation("lip radius", "mm", _MM),
    "container.lip.thickness": Notation("lip thickness", "mm", _MM),
    "container.angle": Notation("angle", "deg", _DEGREE),
    "container.gap": Notation("gap", "mm", _MM),
    "container.width": Notation("width", "mm", _MM),
    "container.height": Notation("height", "mm", _MM),
    "container.thickness": Notation("thickness", "mm", _MM),
    "grains.diameter": Notation("d", "mm", _MM),
    "grains.length": Notation("L", "mm", _MM),
    "grains.density": Notation("density", "kg/m³"),
    "container.rotation": Notation("f", "Hz"),
    "contact.shear_modulus": Notation("shear modulus", "MPa", 1e-6),
    "contact.youngs_modulus": Notation("Young's modulus", "MPa", 1e-6),
    "contact.normal_stiffness": Notation("k_n", "N/m"),
    "numerics.dt": Notation("dt", "µs", 1e6),
    "gravity": Notation("g", "m/s²"),
    "fill.friction": Notation("friction while filling"),
    "fill.max_time": Notation("longest filling", "s"),
}


def key(name: str) -> Notation:
    """Notation of the dotted key of a study; an unknown key is named by its last part, in SI."""
    if name.startswith(("fill.contact.", "fill.numerics.")):
        inner = key(name.removeprefix("fill."))
        return replace(inner, name=f"{inner.name} while filling")
    notation = KEYS.get(name, Notation(name.rsplit(".", 1)[-1].replace("_", " ")))
    if name.startswith("walls."):
        wall = name.split(".")[1]
        notation = replace(notation, name=f"{notation.name} of {'all walls' if wall == 'all' else f'wall {wall}'}")
    return notation


@cache
def _declared() -> dict[str, Notation]:
    """Notations that measures, laws and papers declare, by quantity; a superscript is written ^(...)."""
    declaring = (*MEASURES.values(), FlowPattern(), FlowRegime(), *PAPERS.values())
    declared = (declaration for source in declaring for declaration in source.declared)
    notations = {
        declaration.name: Notation(
            declaration.symbol, declaration.shown or declaration.unit, declaration.scale, declaration.about_zero
        )
        for declaration in declared
    }
    for law in LAWS.values():
        for parameter in law.parameters.values():
            notations[f"{law.name}.{parameter.name}"] = Notation(
                parameter.symbol or parameter.name, parameter.shown or parameter.unit, parameter.scale
            )
    return notations


def quantity(name: str, unit: str = "") -> Notation:
    """Notation of a measured or fitted quantity; an unknown one is named by its own name, in SI (`unit`)."""
    return _declared().get(name) or Notation(name.rsplit(".", 1)[-1].replace("_", " "), unit)


_WORDS = {
    "container.orifice": "orifice D",
    "container.rotation": "rotation f",
    "contact.normal_stiffness": "stiffness k_n",
    "grains.diameter": "diameter d",
    "grains.length": "length L",
    "gravity": "gravity g",
    "numerics.dt": "time step",
}


def spoken(name: str) -> str:
    """Name of the dotted key of a study in a sentence or a title: a word where its notation is a symbol."""
    return _WORDS.get(name, key(name).name)


def law(name: str) -> str:
    """Name of a law or another fit in text: `Beverloo 3d`."""
    return name.replace("_", " ").capitalize()


def percentage(fraction: float) -> str:
    """`±2.4 %` of a relative half-width, to two digits; `unknown` where it has no end."""
    if not math.isfinite(fraction):
        return "unknown"
    return f"±{percent(fraction, '.2g' if fraction < 0.995 else '.0f')}"


def amount(name: str, value: float | str) -> str:
    """The value of a key, without its unit; words as they are."""
    return value if isinstance(value, str) else f"{value * key(name).scale:.6g}"


def setting(name: str, value: float | str) -> str:
    """`D = 30 mm` of a key and its value in SI, or the word that it takes."""
    notation = key(name)
    return f"{notation.name} = {amount(name, value)} {notation.unit}".rstrip()


def label(at: Mapping[str, float | str], leave_out: Collection[str] = ()) -> str:
    """Label of swept values without the keys to leave out: `width = 100 mm, D = 30 mm`."""
    return ", ".join(setting(name, value) for name, value in at.items() if name not in leave_out)


def number(value: float, error: float | None = None, scale: float = 1.0) -> str:
    """`value` times `scale`, to the digits that two significant digits of its error ask for; five without an error."""
    value = value * scale
    if not math.isfinite(value):
        return {math.inf: "∞", -math.inf: "−∞"}.get(value, "–")
    if error is None or not math.isfinite(error) or error <= 0:
        return _minus(f"{value:.4g}")
    error = error * scale
    decimals = 1 - math.floor(math.log10(error))
    if decimals < 0 or decimals > 8:
        return _minus(f"{value:.4g}")
    return _minus(f"{value:.{decimals}f}")


def with_error(value: float, error: float, scale: float = 1.0) -> str:
    """`55.82 ± 0.31`; the error is left out where it is not known."""
    if not math.isfinite(error):
        return number(value, None, scale)
    return f"{number(value, error, scale)} ± {number(error, error, scale)}"


def with_interval(pooled: Pooled, scale: float = 1.0) -> str:
    """`70.0 (66.5 to 73.4, 95 %), n = 3`: a mean with its interval, to the digits that its error asks for."""
    value, low, high = (number(end, pooled.error, scale) for end in (pooled.value, pooled.low, pooled.high))
    finite = math.isfinite(pooled.half_width)
    interval = f"{low} to {high}, {percent(pooled.confidence)}" if finite else "interval unknown"
    return f"{value} ({interval}), n = {pooled.n}"


def _minus(text: str) -> str:
    return text.replace("-", "−")
