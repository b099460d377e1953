"""From the kinds of walls that a scene has to the functions that tell them apart: written out for compilers, and as
objects for plain Python. What the module of a wall defines stands in `labbook_dem.walls`."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from labbook.plugins import BrokenPlugin
from labbook.scene.walls import WallShape
from labbook_dem.formulas import identifier, parameters_of
from labbook_dem.walls import WALLS, number
from labbook_dem.words import vec3, wide3

_TAKES = {"wide": 1, "section": 2, "wide3": 3}
"""Numbers that a parameter of this type takes up."""
NOWHERE = 1e9
"""Distance [m] of what is not there."""


def numbers(shape: WallShape) -> tuple[float, ...]:
    """The numbers of a wall. Raises BrokenPlugin if its functions take more or fewer."""
    found = tuple(WALLS[shape.kind].parameters(shape))
    taken = how_many(shape.kind)
    if len(found) != taken:
        where = WALLS[shape.kind].__name__
        raise BrokenPlugin(
            f"the wall {shape.kind}: {where}.parameters gives {len(found)} numbers, and {taken} are taken"
        )
    return found


def how_many(kind: str) -> int:
    """Numbers that describe a wall of this kind."""
    return sum(_TAKES[of] for _, of in _of_wall(kind, "distance"))


def most_parts(kinds: Iterable[str]) -> int:
    """Points at which a rod may touch one wall of these kinds."""
    return max((WALLS[kind].PARTS for kind in kinds), default=2)


def finds_edges_together(kind: str) -> bool:
    """Whether a wall's edges are found together, by `WALL_edges`."""
    return hasattr(WALLS[kind], f"{identifier(kind)}_edges")


def _of_wall(kind: str, what: str) -> tuple[tuple[str, str], ...]:
    """The parameters of a wall's function that are its numbers: those before `x`."""
    function = f"{identifier(kind)}_{what}"
    try:
        found = parameters_of(WALLS[kind], function)
    except LookupError as error:
        raise BrokenPlugin(f"the wall {kind}: {error}; define it there") from error
    names = [name for name, _ in found]
    if "x" not in names:
        raise BrokenPlugin(f"the wall {kind}: {function} takes no point x; see labbook_dem.walls")
    mine = found[: names.index("x")]
    for name, of in mine:
        if of not in _TAKES:
            known = ", ".join(_TAKES)
            raise BrokenPlugin(f"the wall {kind}: {name} of {function} is no number of a wall; annotate it {known}")
    if what != "distance" and [of for _, of in mine] != [of for _, of in _of_wall(kind, "distance")]:
        raise BrokenPlugin(
            f"the wall {kind}: {function} takes other numbers than {identifier(kind)}_distance; let them agree"
        )
    return mine


def _besides(kind: str, what: str) -> Iterator[str]:
    """Names of what a wall's function takes after its numbers."""
    found = parameters_of(WALLS[kind], f"{identifier(kind)}_{what}")
    return (name for name, _ in found[len(_of_wall(kind, what)) :])


# for compilers


def functions(kinds: Sequence[str], rods: bool, at: str, looks_first: bool = False) -> str:
    """Source of `wall_distance`, and of `wall_part`, `wall_edge` and `wall_edges` for rods, for walls of these kinds.

    They take `walls: Numbers`, and the `kind` of wall w as `number` knows it. at: how a backend writes number {k} of
    wall w, for example `walls[w, {k}]`. looks_first: whether `wall_edges` first looks whether an edge is near, and
    gives none if not: most rods at a wall are far from its edges.
    """
    away = "wide3(wide(0.0), wide(0.0), wide(0.0))"
    nothing = f"wide({NOWHERE})"
    parts = [_function("wall_distance", "x: wide3", kinds, "distance", f"{nothing}, {away}", at)]
    if rods:
        edged = [kind for kind in kinds if WALLS[kind].PARTS > 2]
        together = [kind for kind in kinds if finds_edges_together(kind)]
        found = "met: wide, on: wide, other: wide, back: wide"
        none = f"{nothing}, {away}, wide(0.0)"
        rod = "x: wide3, a: wide3, half: wide, radius: wide"
        parts += [
            # under a branch, also where there is one kind: else a GPU's compiler fuses products and sums of the formula
            # with what stands around it, which differs between kernels that must agree bit for bit
            _function("wall_part", f"{rod}, part: int, {found}", kinds, "rod", none, at, others=True),
            _function("wall_edge", "x: wide3, part: int", edged, "edge", nothing, at, others=len(edged) < len(kinds)),
            _function(
                "wall_edges", rod, together, "edges", f"{nothing}, wide(0.0), {nothing}, wide(0.0)", at,
                others=looks_first or len(together) < len(kinds), guard=_NEAR if looks_first else "",
            ),
        ]  # fmt: skip
    return "\n\n".join([f"# written by {__name__}", *parts])


def _function(
    name: str, takes: str, kinds: Sequence[str], what: str, nothing: str, at: str, others: bool = False,
    guard: str = "",
) -> str:  # fmt: skip
    """A function that calls `WALL_what` of the kind at hand, and gives `nothing` of `others`; guard: see `_call`."""
    lines = ["@func", f"def {name}(walls: Numbers, w: int, kind: int, {takes}):"]
    for place, kind in enumerate(reversed(kinds)):
        last = place == len(kinds) - 1 and not others
        if not last:
            lines.append(f"    if kind == {number(kind)}:")
        lines += [f"{'    ' if last else '        '}{line}" for line in _call(kind, what, at, guard)]
    if not kinds or others:
        lines.append(f"    return {nothing}")
    return "\n".join(lines) + "\n"


_NEAR = "min({wall}_edge({p}, x, 2), {wall}_edge({p}, x, 3)) <= half + radius"


def _call(kind: str, what: str, at: str, guard: str) -> Iterator[str]:
    """Lines that give what `WALL_what` gives, if it is as `guard` says, of a {wall} with the numbers {p}."""
    names, k = [], 0
    for name, of in _of_wall(kind, what):
        mine = [at.format(k=k + i) for i in range(_TAKES[of])]
        mine = mine if of != "section" else [mine[0], "wide(0.0)", mine[1]]
        parts = ", ".join(mine)
        yield f"{name} = {parts if of == 'wide' else f'wide3({parts})'}"
        names.append(name)
        k += _TAKES[of]
    given = f"return {identifier(kind)}_{what}({', '.join([*names, *_besides(kind, what)])})"
    if guard:
        yield f"if {guard.format(wall=identifier(kind), p=', '.join(names))}:"
    yield f"    {given}" if guard else given


# for plain Python


class PlainWall:
    """A wall in plain Python: the functions of its module, with its numbers filled in."""

    def __init__(self, shape: WallShape):
        self.kind = shape.kind
        self._numbers = numbers(shape)
        self._together = finds_edges_together(self.kind)
        self._filled: dict[str, tuple[Any, list[Any], list[str]]] = {}

    def distance(self, x: wide3) -> tuple[float, vec3]:
        """Distance [m] of the point x, and the unit normal from the wall to it."""
        return self._call("distance", {"x": x})

    def part(self, x: wide3, a: wide3, half: float, radius: float, part: int) -> tuple[float, vec3, float]:
        """Of a part of a rod at x along the unit vector a: distance [m], unit normal, and where on the segment [m]."""
        given = {"x": x, "a": a, "half": half, "radius": radius, "part": part}
        if self._together:
            given |= dict(zip(("met", "on", "other", "back"), self._call("edges", given), strict=True))
        return self._call("rod", given)

    def _call(self, what: str, given: Mapping[str, Any]) -> Any:
        if what not in self._filled:
            filled, left = [], iter(self._numbers)
            for _, of in _of_wall(self.kind, what):
                mine = [next(left) for _ in range(_TAKES[of])]
                filled.append(mine[0] if of == "wide" else vec3(*(mine if of == "wide3" else (mine[0], 0.0, mine[1]))))
            function = getattr(WALLS[self.kind], f"{identifier(self.kind)}_{what}")
            self._filled[what] = function, filled, list(_besides(self.kind, what))
        function, filled, names = self._filled[what]
        return function(*filled, *(given[name] for name in names))
