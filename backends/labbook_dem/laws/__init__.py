"""Contact laws, one a module, each with the same two interfaces.

`respond(c, rs, ms, delta, vn, s, vt) -> (fn, ft, s)` is compiled by backends. It takes coefficients c, effective radius
rs [m] and mass ms [kg], overlap delta [m], approach velocity vn [m/s] along n (negative when approaching), trial
friction spring s [m] in the contact plane and tangential velocity vt [m/s]. It returns the normal force [N], the
tangential force on i [N] and the spring for the next step. `normal` returns the normal force alone. `coefficients(law,
surface, scale, wall)` runs on the host and fills the row c, whose places have names (`labbook_dem.coefficients`). A
module may list others in NEEDS, a tuple, whose functions it calls; those of `labbook_dem.contact` are always available,
among them `length` and `cut` for divisions by a length that may vanish.

The types of scenes name the laws (`labbook.scene.contact.CONTACT_LAWS`): `hertz-mindlin` has its formulas in the module
`hertz_mindlin` here, and a law of another package in the module that its type states in `physics`.
"""

from types import ModuleType

from labbook.scene.contact import CONTACT_LAWS
from labbook_dem.formulas import Formulas

REQUIRED = ("coefficients", "respond", "normal")
"""Names that the module of a law must define."""

LAWS = Formulas("contact law", __name__, CONTACT_LAWS, lambda _name: REQUIRED)
"""Modules of the laws by name."""


def modules_of(name: str) -> tuple[ModuleType, ...]:
    """Modules of a law in the order of compilation: those that it needs, then its own."""
    return (*getattr(LAWS[name], "NEEDS", ()), LAWS[name])
