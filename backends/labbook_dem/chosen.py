"""The contact law that contacts of spheres and rods follow, wherever they are computed.

A backend that compiles puts a law's own functions in place of these. In plain Python a law is chosen first:

    with choose("linear") as law:
        c = law.coefficients(contact, surface)
        force, *_ = sphere_on_wall(c, ...)

Coefficients of one law mean nothing to another, and cannot be told apart. So there is no law until one is chosen.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import ModuleType

from labbook_dem import words
from labbook_dem.laws import LAWS
from labbook_dem.words import coefs, real, vec3

_law: ContextVar[ModuleType] = ContextVar("law")


@contextmanager
def choose(name: str, twist: bool = True) -> Iterator[ModuleType]:
    """Follow the law called `name`, as scenes call it, in this thread and block; gives the law's module.

    twist: whether rolling resistance acts on twist too (`contact.rolling: full`). Raises ValueError if there is no such
    law.
    """
    if name not in LAWS:
        raise ValueError(f"no contact law is called {name}; there are {', '.join(LAWS)}")
    before, twisted = _law.set(LAWS[name]), words.twist.on.set(twist)
    try:
        yield LAWS[name]
    finally:
        words.twist.on.reset(twisted)
        _law.reset(before)


def _chosen() -> ModuleType:
    law = _law.get(None)
    if law is None:
        raise RuntimeError("no contact law is chosen; compute contacts within labbook_dem.chosen.choose(NAME)")
    return law


def respond(c: coefs, rs: real, ms: real, delta: real, vn: real, s: vec3, vt: vec3):
    """Normal force, tangential force on i and the spring by the chosen law; see `labbook_dem.laws`."""
    return _chosen().respond(c, rs, ms, delta, vn, s, vt)


def normal(c: coefs, rs: real, ms: real, delta: real, vn: real):
    """Normal force alone by the chosen law."""
    return _chosen().normal(c, rs, ms, delta, vn)
