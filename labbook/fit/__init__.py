"""Laws of flow through an outlet, and fitting them to flow rates with known errors."""

from labbook.fit.beverloo import Beverloo2D, Beverloo3D
from labbook.fit.exponential import Exponential
from labbook.fit.fitting import contenders, fit
from labbook.fit.janda import Janda2D, Janda3D
from labbook.fit.law import Context, Law
from labbook.fit.power import Power
from labbook.fit.result import NOT_DETERMINED, FitError, FitResult, Parameter
from labbook.plugins import Registry

LAWS: Registry[Law] = Registry[Law](
    "labbook.laws",
    Law,
    (Beverloo2D(), Janda2D(), Beverloo3D(), Janda3D(), Power(), Exponential()),
)
"""Laws of the flow rate against the orifice: those built in, and those of other packages."""


def law_name(law: str) -> str:
    """Name of a law that is written as reports show it.

    Args:
        law: Text such as `Beverloo 3d`.

    Returns:
        `beverloo_3d`; a text that names no law is unchanged.
    """
    plain = law.strip().lower().replace(" ", "_")
    return plain if plain in LAWS else law


__all__ = [
    "LAWS",
    "NOT_DETERMINED",
    "Context",
    "FitError",
    "FitResult",
    "Law",
    "Parameter",
    "contenders",
    "fit",
    "law_name",
]
