"""Contact law and walls of the present scene.

A backend that compiles replaces these functions: by those of a law, and by those that `labbook_dem.dispatch` writes for
the kinds of walls of a scene. In plain Python a law is chosen first, and a wall is a `PlainWall` from there:

    with choose("linear") as law:
        c = law.coefficients(contact, surface)
        force, *_ = sphere_on_wall(c, ...)

The coefficients of one law mean nothing to another and look the same, so there is no law until one is chosen.
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
    """Use the law called `name` in this thread and block; yield its module.

    Args:
        name: name of the law in scenes.
        twist: rolling resistance acts on twist too (`contact.rolling: full`).
        springs: rolling resistance has springs (`contact.rolling_model: epsd`), so that `spheres.touch` leaves it to
            `spheres.rolling_on_sphere` and `rolling_on_wall`.

    Raises:
        ValueError: there is no such law.
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


def _current_law() -> ModuleType:
    law = _law.get(None)
    if law is None:
        raise RuntimeError("no contact law is chosen; compute contacts within labbook_dem.chosen.choose(NAME)")
    return law


def respond(c: coefs, rs: real, ms: real, delta: real, vn: real, s: vec3, vt: vec3):
    """Normal force, tangential force on i and the spring by the chosen law; see `labbook_dem.laws`."""
    return _current_law().respond(c, rs, ms, delta, vn, s, vt)


def normal(c: coefs, rs: real, ms: real, delta: real, vn: real):
    """Normal force alone by the chosen law."""
    return _current_law().normal(c, rs, ms, delta, vn)


_GENERATED = "written by labbook_dem.dispatch for the walls of a scene; plain Python has labbook_dem.dispatch.PlainWall"


def wall_distance(walls: Any, w: int, kind: int, x: wide3) -> tuple[wide, wide3]:
    """Distance [m] of the point x from wall w, and the unit normal from the wall to it.

    walls: the numbers of walls, as a backend keeps them; kind: that of wall w (`labbook_dem.walls.number`).
    """
    raise NotImplementedError(_GENERATED)


def wall_part(
    walls: Any, w: int, kind: int, x: wide3, a: wide3, half: wide, radius: wide, part: int, met: wide, on: wide,
    other: wide, back: wide,
) -> tuple[wide, wide3, wide]:  # fmt: skip
    """Distance [m] of a part of a rod at x along a from wall w, unit normal, and position on the segment [m].

    met, on, other, back: from `wall_edges`.
    """
    raise NotImplementedError(_GENERATED)


def wall_edge(walls: Any, w: int, kind: int, x: wide3, part: int) -> wide:
    """Distance [m] of the point x from the edge of wall w for part 2 or 3 of a rod; 1e9 without an edge."""
    raise NotImplementedError(_GENERATED)


def wall_edges(
    walls: Any, w: int, kind: int, x: wide3, a: wide3, half: wide, radius: wide
) -> tuple[wide, wide, wide, wide]:  # fmt: skip
    """Distances [m] of parts 2 and 3 of a rod from the edges of wall w, and positions on the segment; 1e9 without an
    edge."""
    raise NotImplementedError(_GENERATED)
