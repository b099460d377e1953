"""What a scene chooses: the contact law that its contacts follow, and the walls that it has.

A backend that compiles puts other functions in place of these: a law's own, and those that `labbook_dem.dispatch`
writes for the kinds of walls there are. In plain Python a law is chosen first, and a wall is a `PlainWall` from there:

    with choose("linear") as law:
        c = law.coefficients(contact, surface)
        force, *_ = sphere_on_wall(c, ...)

Coefficients of one law mean nothing to another, and cannot be told apart. So there is no law until one is chosen.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import ModuleType
from typing import Any

from labbook_dem import words
from labbook_dem.laws import LAWS
from labbook_dem.words import coefs, real, vec3, wide, wide3

_law: ContextVar[ModuleType] = ContextVar("law")


@contextmanager
def choose(name: str, twist: bool = True, springs: bool = False) -> Iterator[ModuleType]:
    """Follow the law called `name`, as scenes call it, in this thread and block; gives the law's module.

    twist: whether rolling resistance acts on twist too (`contact.rolling: full`). springs: whether it has springs
    (`contact.rolling_model: epsd`), so that `spheres.touch` leaves it to `spheres.rolling_on_sphere` and
    `rolling_on_wall`. Raises ValueError if there is no such law.
    """
    if name not in LAWS:
        raise ValueError(f"no contact law is called {name}; there are {', '.join(LAWS)}")
    before, twisted, rolled = _law.set(LAWS[name]), words.twist.on.set(twist), words.rolling.on.set(not springs)
    try:
        yield LAWS[name]
    finally:
        words.rolling.on.reset(rolled)
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


_WRITTEN = "written by labbook_dem.dispatch for the walls of a scene; plain Python has labbook_dem.dispatch.PlainWall"


def wall_distance(walls: Any, w: int, kind: int, x: wide3) -> tuple[wide, wide3]:
    """Distance [m] of the point x from wall w, and the unit normal from the wall to it.

    walls: the numbers of walls, as a backend keeps them; kind: that of wall w (`labbook_dem.walls.number`).
    """
    raise NotImplementedError(_WRITTEN)


def wall_part(
    walls: Any, w: int, kind: int, x: wide3, a: wide3, half: wide, radius: wide, part: int, met: wide, on: wide,
    other: wide, back: wide,
) -> tuple[wide, wide3, wide]:  # fmt: skip
    """Of a part of a rod at x along a: distance [m] from wall w, unit normal, and where on the segment it is [m].

    met, on, other, back: what `wall_edges` gave.
    """
    raise NotImplementedError(_WRITTEN)


def wall_edge(walls: Any, w: int, kind: int, x: wide3, part: int) -> wide:
    """Distance [m] of the point x from the edge of wall w that part 2 or 3 of a rod lies across; 1e9 if it has none."""
    raise NotImplementedError(_WRITTEN)


def wall_edges(
    walls: Any, w: int, kind: int, x: wide3, a: wide3, half: wide, radius: wide
) -> tuple[wide, wide, wide, wide]:  # fmt: skip
    """Of parts 2 and 3 of a rod at wall w: distance [m] from its edge, and where on the segment; 1e9 if it has none."""
    raise NotImplementedError(_WRITTEN)
