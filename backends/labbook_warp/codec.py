"""State of grains that other threads read, packed into words of 16 bytes, which host and kernels read and write.

A word holds, in this order, vectors in double precision, then vectors in the precision of velocities. `Codec` is the
host's part; `kernel_text` writes the functions of kernels (listed in `labbook_warp.kernels.shown`).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np


class GrainFields(NamedTuple):
    """Shared fields of grains of a shape.

    Attributes:
        exact: vectors in double precision, x first.
        moving: vectors in the precision of velocities, v and w first.
        rounding: the rounding error of a velocity follows, if velocities are in single precision.
    """

    exact: tuple[str, ...]
    moving: tuple[str, ...]
    rounding: bool


class States(NamedTuple):
    """States of n grains.

    Attributes:
        x: positions [m], shape [n, 3].
        v: velocities half a step before [m/s], shape [n, 3].
        m: reduced angular momenta half a step before [rad/s], shape [n, 3].
        q: orientations of rods, shape [n, 4].
    """

    x: np.ndarray
    v: np.ndarray
    m: np.ndarray
    q: np.ndarray | None = None


class Codec:
    """Words of grains in host arrays. In mixed precision velocities are in single, else in double precision."""

    def __init__(self, mixed: bool, fields: GrainFields):
        self.mixed, self.fields = mixed, fields
        self.exact = 3 * len(fields.exact) * (2 if mixed else 1)
        """Numbers of the vectors in double precision; in mixed precision each is stored as two singles."""
        self._used = self.exact + 3 * len(fields.moving)
        self.rounding = mixed and fields.rounding
        self.numbers = 4 if mixed else 2
        """Numbers of a word."""
        self.words = -(-(self._used + self.rounding) // self.numbers)
        """Words of a grain."""

    def encode(self, x: np.ndarray, v: np.ndarray, w: np.ndarray, axis: np.ndarray | None = None) -> np.ndarray:
        """Encode grains whose predicted velocities equal the present ones.

        Args:
            x: positions [m], shape [n, 3].
            v: velocities [m/s].
            w: angular velocities [rad/s].
            axis: unit vectors of rods.

        Returns:
            Numbers of all words, shape [n, words times numbers].
        """
        vectors = {"x": x, "axis": axis, "v": v, "w": w, "u": v, "y": w}
        exact, moving = ([vectors[name] for name in names] for names in (self.fields.exact, self.fields.moving))
        if self.mixed:
            exact = [np.ascontiguousarray(a).view(np.float32) for a in exact]
            moving = [np.asarray(a, np.float32) for a in moving]
        padding = np.zeros((len(x), self.words * self.numbers - self._used), exact[0].dtype)
        return np.hstack([*exact, *moving, padding])

    def with_velocities(self, numbers: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return a copy with velocities v [m/s], shape [n, 3], also as predicted ones, and zero rounding errors."""
        changed = numbers.copy()
        for index, name in enumerate(self.fields.moving):
            if name in ("v", "u"):
                first = self.exact + 3 * index
                changed[:, first : first + 3] = v
        changed[:, self._used :] = 0
        return changed

    def decode(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x, v and w in double precision, shape [n, 3] each."""
        x = np.ascontiguousarray(numbers[:, : self.exact]).view(np.float64)[:, :3].copy()
        v, w = (numbers[:, self.exact + k : self.exact + k + 3].astype(np.float64) for k in (0, 3))
        return x, v, w


def kernel_text(codec: Codec) -> str:
    """Source of `GrainPosition`, `position`, `motion`, `rounding_error` and `put`, which `kernels.shown` lists."""
    parts = ["\n".join(lines) + "\n" for lines in (_record(codec), *_functions(codec))]
    return "\n\n".join([f"# written by {__name__}", *parts])


_WORD = "shared"
"""Field of GrainPosition: the word that contains both the end of the vectors in double and the start of the others."""


def _split(codec: Codec) -> bool:
    return codec.exact % codec.numbers > 0


def _record(codec: Codec) -> Iterator[str]:
    yield "@struct"
    yield "class GrainPosition:"
    yield from (f"    {name}: wide3" for name in codec.fields.exact)
    if _split(codec):
        yield f"    {_WORD}: word"


def _functions(codec: Codec) -> Iterator[Iterator[str]]:
    begins = -(-codec.exact // codec.numbers)
    yield _position(codec, begins)
    yield _motion(codec, begins)
    yield iter(_rounding(codec))
    yield _put(codec)


def _loads(codec: Codec, first: int, last: int) -> Iterator[str]:
    for k in range(first, last):
        yield f"    n{k} = load_word(p, i * {codec.words} + {k})" if k else f"    n0 = load_word(p, i * {codec.words})"


def _number(codec: Codec, at: int) -> str:
    return f"n{at // codec.numbers}[{at % codec.numbers}]"


def _position(codec: Codec, begins: int) -> Iterator[str]:
    yield "@func"
    yield "def position(p: Words, i: int):"
    yield from _loads(codec, 0, begins)
    yield "    s = GrainPosition()"
    for k, name in enumerate(codec.fields.exact):
        if codec.mixed:
            at = range(6 * k, 6 * k + 6, 2)
            parts = [f"joined({_number(codec, low)}, {_number(codec, low + 1)})" for low in at]
        else:
            parts = [_number(codec, 3 * k + c) for c in range(3)]
        yield f"    s.{name} = wide3({', '.join(parts)})"
    if _split(codec):
        yield f"    s.{_WORD} = n{begins - 1}"
    yield "    return s"


def _motion(codec: Codec, begins: int) -> Iterator[str]:
    yield "@func"
    yield "def motion(p: Words, i: int, s: GrainPosition):"
    yield from _loads(codec, begins, codec.words)
    vectors = []
    for k in range(len(codec.fields.moving)):
        at = [_number(codec, codec.exact + 3 * k + c) for c in range(3)]
        vectors.append(f"vec3({', '.join(at)})".replace(f"n{begins - 1}[", f"s.{_WORD}["))
    yield f"    return {', '.join(vectors)}"


def _rounding(codec: Codec) -> list[str]:
    lines = ["@func", "def rounding_error(p: Words, i: int):"]
    if not codec.rounding:
        return [*lines, "    return real(0.0)"]
    last = codec.words - 1
    return [*lines, *_loads(codec, last, last + 1), f"    return {_number(codec, codec.words * codec.numbers - 1)}"]


def _put(codec: Codec) -> Iterator[str]:
    exact, moving = codec.fields.exact, codec.fields.moving
    parameters = [f"{name}: wide3" for name in exact] + [f"{name}: vec3" for name in moving]
    yield "@func"
    yield f"def put(p: Words, i: int, {', '.join(parameters)}{', rounding: real' if codec.fields.rounding else ''}):"
    wide_numbers = [f"{name}[{c}]" for name in exact for c in range(3)]
    numbers = wide_numbers
    if codec.mixed:
        numbers = [f"halved({number}, {half})" for number in wide_numbers for half in (0, 1)]
    numbers = [
        *numbers,
        *(f"{name}[{c}]" for name in moving for c in range(3)),
        *(["rounding"] if codec.rounding else []),
    ]
    for k in range(codec.words):
        word_numbers = numbers[k * codec.numbers : (k + 1) * codec.numbers]
        yield f"    store_word(p, i * {codec.words}{f' + {k}' if k else ''}, word({', '.join(word_numbers)}))"
