"""What a grain shows to others, as words of 16 bytes: written and read by the host, and by kernels.

The words hold, one after another, vectors in double and vectors of the precision of velocities. `Codec` is the host's;
`kernel_text` writes the functions that kernels call (listed in `labbook_warp.kernels.shown`).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np


class GrainFields(NamedTuple):
    """What grains of a shape show. exact: vectors in double, x among them as the first; others: of the precision of
    velocities, v and w among them as the first; rest: whether what rounding has kept of a velocity stands behind them,
    where velocities are in single."""

    exact: tuple[str, ...]
    others: tuple[str, ...]
    rest: bool


class States(NamedTuple):
    """Positions x [m], shape [n, 3]; velocities v [m/s] and reduced angular momenta m [rad/s], half a step before; and
    of rods the orientations q, shape [n, 4]."""

    x: np.ndarray
    v: np.ndarray
    m: np.ndarray
    q: np.ndarray | None = None


class Codec:
    """Words of grains in arrays on the host. In mixed precision velocities are in single, else in double."""

    def __init__(self, mixed: bool, shown: GrainFields):
        self.mixed, self.shown = mixed, shown
        self.exact = 3 * len(shown.exact) * (2 if mixed else 1)
        """Numbers that the vectors in double take up: two in single each, in mixed precision."""
        self._used = self.exact + 3 * len(shown.others)
        self.rest = mixed and shown.rest
        self.numbers = 4 if mixed else 2
        """Of a word."""
        self.words = -(-(self._used + self.rest) // self.numbers)
        """Of a grain."""

    def encode(self, x: np.ndarray, v: np.ndarray, w: np.ndarray, axis: np.ndarray | None = None) -> np.ndarray:
        """Numbers of grains that are predicted to go on as they do, shape [n, numbers of all words].

        x [m], v [m/s], w [rad/s] and the unit vectors `axis` of rods: shape [n, 3].
        """
        known = {"x": x, "axis": axis, "v": v, "w": w, "u": v, "y": w}
        exact, others = ([known[name] for name in names] for names in (self.shown.exact, self.shown.others))
        if self.mixed:
            exact = [np.ascontiguousarray(a).view(np.float32) for a in exact]
            others = [np.asarray(a, np.float32) for a in others]
        rest = np.zeros((len(x), self.words * self.numbers - self._used), exact[0].dtype)
        return np.hstack([*exact, *others, rest])

    def with_velocities(self, numbers: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Numbers of grains with other velocities v [m/s], shape [n, 3], also as predicted, and nothing that rounding
        has kept."""
        changed = numbers.copy()
        for place, name in enumerate(self.shown.others):
            if name in ("v", "u"):
                first = self.exact + 3 * place
                changed[:, first : first + 3] = v
        changed[:, self._used :] = 0
        return changed

    def decode(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x, v and w, in double."""
        x = np.ascontiguousarray(numbers[:, : self.exact]).view(np.float64)[:, :3].copy()
        v, w = (numbers[:, self.exact + k : self.exact + k + 3].astype(np.float64) for k in (0, 3))
        return x, v, w


def kernel_text(codec: Codec) -> str:
    """Source of `Spot`, `spot`, `motion`, `rest` and `put` of `labbook_warp.kernels.shown`."""
    written = ["\n".join(lines) + "\n" for lines in (_record(codec), *_functions(codec))]
    return "\n\n".join([f"# written by {__name__}", *written])


_WORD = "shared"
"""Of Spot: the word in which the vectors in double end and the others begin."""


def _split(codec: Codec) -> bool:
    return codec.exact % codec.numbers > 0


def _record(codec: Codec) -> Iterator[str]:
    yield "@struct"
    yield "class Spot:"
    yield from (f"    {name}: wide3" for name in codec.shown.exact)
    if _split(codec):
        yield f"    {_WORD}: word"


def _functions(codec: Codec) -> Iterator[Iterator[str]]:
    begins = -(-codec.exact // codec.numbers)
    yield _spot(codec, begins)
    yield _motion(codec, begins)
    yield iter(_rest(codec))
    yield _put(codec)


def _loads(codec: Codec, first: int, last: int) -> Iterator[str]:
    for k in range(first, last):
        yield f"    n{k} = load_word(p, i * {codec.words} + {k})" if k else f"    n0 = load_word(p, i * {codec.words})"


def _number(codec: Codec, at: int) -> str:
    return f"n{at // codec.numbers}[{at % codec.numbers}]"


def _spot(codec: Codec, begins: int) -> Iterator[str]:
    yield "@func"
    yield "def spot(p: Words, i: int):"
    yield from _loads(codec, 0, begins)
    yield "    s = Spot()"
    for k, name in enumerate(codec.shown.exact):
        if codec.mixed:
            at = range(6 * k, 6 * k + 6, 2)
            parts = [f"joined({_number(codec, one)}, {_number(codec, one + 1)})" for one in at]
        else:
            parts = [_number(codec, 3 * k + c) for c in range(3)]
        yield f"    s.{name} = wide3({', '.join(parts)})"
    if _split(codec):
        yield f"    s.{_WORD} = n{begins - 1}"
    yield "    return s"


def _motion(codec: Codec, begins: int) -> Iterator[str]:
    yield "@func"
    yield "def motion(p: Words, i: int, s: Spot):"
    yield from _loads(codec, begins, codec.words)
    vectors = []
    for k in range(len(codec.shown.others)):
        at = [_number(codec, codec.exact + 3 * k + c) for c in range(3)]
        vectors.append(f"vec3({', '.join(at)})".replace(f"n{begins - 1}[", f"s.{_WORD}["))
    yield f"    return {', '.join(vectors)}"


def _rest(codec: Codec) -> list[str]:
    lines = ["@func", "def rest(p: Words, i: int):"]
    if not codec.rest:
        return [*lines, "    return real(0.0)"]
    last = codec.words - 1
    return [*lines, *_loads(codec, last, last + 1), f"    return {_number(codec, codec.words * codec.numbers - 1)}"]


def _put(codec: Codec) -> Iterator[str]:
    exact, others = codec.shown.exact, codec.shown.others
    takes = [f"{name}: wide3" for name in exact] + [f"{name}: vec3" for name in others]
    yield "@func"
    yield f"def put(p: Words, i: int, {', '.join(takes)}{', more: real' if codec.shown.rest else ''}):"
    wide = [f"{name}[{c}]" for name in exact for c in range(3)]
    numbers = [f"halved({one}, {half})" for one in wide for half in (0, 1)] if codec.mixed else wide
    numbers += [f"{name}[{c}]" for name in others for c in range(3)] + (["more"] if codec.rest else [])
    for k in range(codec.words):
        own = numbers[k * codec.numbers : (k + 1) * codec.numbers]
        yield f"    store_word(p, i * {codec.words}{f' + {k}' if k else ''}, word({', '.join(own)}))"
