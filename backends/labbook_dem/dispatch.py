"""Functions that select the formulas of a wall by its kind: source for compilers, objects for plain Python.

`labbook_dem.walls` states the definitions that the module of a wall must have.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from labbook.plugins import BrokenPlugin
from labbook.scene.walls import WallShape
from labbook_dem.formulas import identifier, parameters_of
from labbook_dem.walls import WALLS, number
from labbook_dem.words import vec3, wide3

_TAKES = {"wide": 1, "section": 2, "wide3": 3}
"""Length of a parameter of this type, in numbers of a wall."""
NOWHERE = 1e9
"""Distance [m] from a part that does not exist."""


def numbers(shape: WallShape) -> tuple[float, ...]:
    """Numbers of a wall. Raises BrokenPlugin if its functions take more or fewer."""
    parameters = tuple(WALLS[shape.kind].parameters(shape))
    expected = how_many(shape.kind)
    if len(parameters) != expected:
        where = WALLS[shape.kind].__name__
        raise BrokenPlugin(
            f"the wall {shape.kind}: {where}.parameters gives {len(parameters)} numbers, and {expected} are taken"
        )
    return parameters


def how_many(kind: str) -> int:
    """Length of the numbers of a wall of this kind."""
    return sum(_TAKES[of] for _, of in _of_wall(kind, "distance"))


def most_parts(kinds: Iterable[str]) -> int:
    """Largest number of points at which a rod may touch one wall of these kinds."""
    return max((WALLS[kind].PARTS for kind in kinds), default=2)


def finds_edges_together(kind: str) -> bool:
    """True if the kind has a common search for both edges, `WALL_edges`."""
    return hasattr(WALLS[kind], f"{identifier(kind)}_edges")


def _of_wall(kind: str, operation: str) -> tuple[tuple[str, str], ...]:
    """Parameters of a wall's function that are its numbers: those before `x`."""
    function = f"{identifier(kind)}_{operation}"
    try:
        parameters = parameters_of(WALLS[kind], function)
    except LookupError as error:
        raise BrokenPlugin(f"the wall {kind}: {error}; define it there") from error
    names = [name for name, _ in parameters]
    if "x" not in names:
        raise BrokenPlugin(f"the wall {kind}: {function} takes no point x; see labbook_dem.walls")
    wall_parameters = parameters[: names.index("x")]
    for name, of in wall_parameters:
        if of not in _TAKES:
            types = ", ".join(_TAKES)
            raise BrokenPlugin(
                f"the wall {kind}: {name} of {function} is not annotated as a number of a wall; annotate it {types}"
            )
    if operation != "distance" and [of for _, of in wall_parameters] != [of for _, of in _of_wall(kind, "distance")]:
        raise BrokenPlugin(
            f"the wall {kind}: {function} takes other numbers than {identifier(kind)}_distance; let them agree"
        )
    return wall_parameters


def _besides(kind: str, operation: str) -> Iterator[str]:
    """Names of the parameters of a wall's function after its numbers."""
    parameters = parameters_of(WALLS[kind], f"{identifier(kind)}_{operation}")
    return (name for name, _ in parameters[len(_of_wall(kind, operation)) :])


# for compilers


def functions(kinds: Sequence[str], rods: bool, at: str, looks_first: bool = False) -> str:
    """Source of `wall_distance`, and for rods of `wall_part`, `wall_edge` and `wall_edges`, for walls of these kinds.

    They take `walls: Numbers`, and the `kind` of wall w as `number` gives it.

    Args:
        kinds: kinds of walls.
        rods: grains are rods.
        at: expression of a backend for number {k} of wall w, for example `walls[w, {k}]`.
        looks_first: `wall_edges` first tests for a near edge, and returns no edge otherwise: most rods at a wall are
            far from its edges.
    """
    away = "wide3(wide(0.0), wide(0.0), wide(0.0))"
    nowhere = f"wide({NOWHERE})"
    parts = [_function("wall_distance", "x: wide3", kinds, "distance", f"{nowhere}, {away}", at)]
    if rods:
        kinds = [kind for kind in kinds if hasattr(WALLS[kind], f"{identifier(kind)}_rod")]
        edged = [kind for kind in kinds if WALLS[kind].PARTS > 2]
        together = [kind for kind in kinds if finds_edges_together(kind)]
        edges = "met: wide, on: wide, other: wide, back: wide"
        no_part = f"{nowhere}, {away}, wide(0.0)"
        rod = "x: wide3, a: wide3, half: wide, radius: wide"
        parts += [
            # under a branch, even for a single kind: otherwise a GPU's compiler fuses products and sums of the formula
            # with the code around it, which differs between kernels that must agree bit for bit
            _function("wall_part", f"{rod}, part: int, {edges}", kinds, "rod", no_part, at, fallback=True),
            _function("wall_edge", "x: wide3, part: int", edged, "edge", nowhere, at, fallback=len(edged) < len(kinds)),
            _function(
                "wall_edges", rod, together, "edges", f"{nowhere}, wide(0.0), {nowhere}, wide(0.0)", at,
                fallback=looks_first or len(together) < len(kinds), guard=_NEAR if looks_first else "",
            ),
        ]  # fmt: skip
    return "\n\n".join([f"# written by {__name__}", *parts])


def _function(
    name: str, parameters: str, kinds: Sequence[str], operation: str, default: str, at: str, fallback: bool = False,
    guard: str = "",
) -> str:  # fmt: skip
    """Source of a function that calls `WALL_operation` of a kind, and returns `default` for others if `fallback`;
    guard: see `_call`."""
    lines = ["@func", f"def {name}(walls: Numbers, w: int, kind: int, {parameters}):"]
    for index, kind in enumerate(reversed(kinds)):
        last = index == len(kinds) - 1 and not fallback
        if not last:
            lines.append(f"    if kind == {number(kind)}:")
        lines += [f"{'    ' if last else '        '}{line}" for line in _call(kind, operation, at, guard)]
    if not kinds or fallback:
        lines.append(f"    return {default}")
    return "\n".join(lines) + "\n"


_NEAR = "min({wall}_edge({p}, x, 2), {wall}_edge({p}, x, 3)) <= half + radius"


def _call(kind: str, operation: str, at: str, guard: str) -> Iterator[str]:
    """Lines that return `WALL_operation` of a {wall} with the numbers {p}, if the condition `guard` holds."""
    names, k = [], 0
    for name, of in _of_wall(kind, operation):
        values = [at.format(k=k + i) for i in range(_TAKES[of])]
        values = values if of != "section" else [values[0], "wide(0.0)", values[1]]
        parts = ", ".join(values)
        yield f"{name} = {parts if of == 'wide' else f'wide3({parts})'}"
        names.append(name)
        k += _TAKES[of]
    returned = f"return {identifier(kind)}_{operation}({', '.join([*names, *_besides(kind, operation)])})"
    if guard:
        yield f"if {guard.format(wall=identifier(kind), p=', '.join(names))}:"
    yield f"    {returned}" if guard else returned


# for plain Python


class PlainWall:
    """Wall in plain Python: the functions of its module, with its numbers as arguments."""

    def __init__(self, shape: WallShape):
        self.kind = shape.kind
        self._numbers = numbers(shape)
        self._together = finds_edges_together(self.kind)
        self._functions: dict[str, tuple[Any, list[Any], list[str]]] = {}

    def distance(self, x: wide3) -> tuple[float, vec3]:
        """Distance [m] of the point x, and the unit normal from the wall to it."""
        return self._call("distance", {"x": x})

    def part(self, x: wide3, a: wide3, half: float, radius: float, part: int) -> tuple[float, vec3, float]:
        """Part of a rod at x along the unit vector a: distance [m], unit normal, and position on the segment [m]."""
        arguments = {"x": x, "a": a, "half": half, "radius": radius, "part": part}
        if self._together:
            arguments |= dict(zip(("met", "on", "other", "back"), self._call("edges", arguments), strict=True))
        return self._call("rod", arguments)

    def _call(self, operation: str, arguments: Mapping[str, Any]) -> Any:
        if operation not in self._functions:
            values, remaining = [], iter(self._numbers)
            for _, of in _of_wall(self.kind, operation):
                p = [next(remaining) for _ in range(_TAKES[of])]
                values.append(p[0] if of == "wide" else vec3(*(p if of == "wide3" else (p[0], 0.0, p[1]))))
            function = getattr(WALLS[self.kind], f"{identifier(self.kind)}_{operation}")
            self._functions[operation] = function, values, list(_besides(self.kind, operation))
        function, values, names = self._functions[operation]
        return function(*values, *(arguments[name] for name in names))
