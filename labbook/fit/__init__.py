"""Laws of flow through an outlet, and fitting them to flow rates with known errors."""

from labbook.fit.beverloo import Beverloo2D
from labbook.fit.fitting import compare, fit
from labbook.fit.janda import Janda2D
from labbook.fit.law import Context, Law
from labbook.fit.result import FitError, FitResult, Parameter

LAWS: dict[str, Law] = {law.name: law for law in (Beverloo2D(), Janda2D())}
"""The laws that a study can name under `fit`."""

__all__ = ["LAWS", "Context", "FitError", "FitResult", "Law", "Parameter", "compare", "fit"]
