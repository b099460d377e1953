"""Profiles of velocity and area fraction along outlets: their parameters, and the flow rate that they come to."""

from labbook.fit.outlet.approach import TERMS, Approach, approach_at, fit_approach
from labbook.fit.outlet.curves import Curve
from labbook.fit.outlet.joint import (
    COVERAGE,
    CROSSINGS,
    DEFINITIONS,
    FORMULA,
    OF_OUTLET,
    PARAMETERS,
    SOURCE,
    VERSION,
    FittedOutlet,
    ProfileFit,
    fit_profiles,
)
from labbook.fit.outlet.saturation import Saturation, fit_saturation
from labbook.fit.outlet.shape import Outlet, dome, middle_speed, tilted

__all__ = [
    "COVERAGE",
    "CROSSINGS",
    "DEFINITIONS",
    "FORMULA",
    "OF_OUTLET",
    "PARAMETERS",
    "SOURCE",
    "TERMS",
    "VERSION",
    "Approach",
    "Curve",
    "FittedOutlet",
    "Outlet",
    "ProfileFit",
    "Saturation",
    "approach_at",
    "dome",
    "fit_approach",
    "fit_profiles",
    "fit_saturation",
    "middle_speed",
    "tilted",
]
