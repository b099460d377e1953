"""States of grains as arrays on the host, and as the words that kernels read; see the kernels `mixed` and `double`."""

from typing import NamedTuple

import numpy as np


class States(NamedTuple):
    """Positions x [m], shape [n, 3]; velocities v [m/s] and reduced angular momenta m [rad/s], half a step before; and
    of rods the orientations q, shape [n, 4]."""

    x: np.ndarray
    v: np.ndarray
    m: np.ndarray
    q: np.ndarray | None = None


class Codec:
    """What a grain shows to others as words of 16 bytes: position, axis of a rod, velocity and spin, the velocity and
    (of a rod) the spin as predicted, and what fills the last.

    In mixed precision the first two are in double and the others in single.
    """

    def __init__(self, mixed: bool, rods: bool):
        self.mixed, self.rods = mixed, rods
        doubles, others = 3 + 3 * rods, 9 + 3 * rods
        self._used = 2 * doubles + others if mixed else doubles + others
        self.numbers = 4 if mixed else 2
        """Of a word."""
        self.words = -(-(self._used + (mixed and not rods)) // self.numbers)  # and what rounding has kept of a sphere
        """Of a grain."""

    def encode(self, x: np.ndarray, v: np.ndarray, w: np.ndarray, axis: np.ndarray | None = None) -> np.ndarray:
        """Numbers of grains that are predicted to go on as they do, shape [n, numbers of all words].

        x [m], v [m/s], w [rad/s] and the unit vectors `axis` of rods: shape [n, 3].
        """
        exact, others = [x], [v, w, v]
        if axis is not None:
            exact, others = [x, axis], [v, w, v, w]
        if self.mixed:
            exact = [np.ascontiguousarray(a).view(np.float32) for a in exact]
            others = [np.asarray(a, np.float32) for a in others]
        rest = np.zeros((len(x), self.words * self.numbers - self._used), exact[0].dtype)
        return np.hstack([*exact, *others, rest])

    def decode(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x, v and w, in double."""
        exact = (3 + 3 * self.rods) * (2 if self.mixed else 1)
        x = np.ascontiguousarray(numbers[:, :exact]).view(np.float64)[:, :3].copy()
        v, w = (numbers[:, exact + k : exact + k + 3].astype(np.float64) for k in (0, 3))
        return x, v, w
