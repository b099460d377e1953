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
    """Words of 16 bytes: position, orientation of rods, v, m, v and (of rods) m as predicted, and what fills the last.

    In mixed precision the first two are in double and the others in single.
    """

    def __init__(self, mixed: bool, rods: bool):
        self.mixed, self.rods = mixed, rods
        doubles, others = 3 + 4 * rods, 9 + 3 * rods
        self._used = 2 * doubles + others if mixed else doubles + others
        self.numbers = 4 if mixed else 2
        """Of a word."""
        self.words = -(-(self._used + mixed) // self.numbers)  # mixed: and what rounding has kept
        """Of a grain."""

    def encode(self, s: States) -> np.ndarray:
        """Numbers of grains that are predicted to go on as they do, shape [n, numbers of all words]."""
        parts = [s.x, s.v, s.m, s.v]
        if self.rods:
            parts = [s.x, s.q, s.v, s.m, s.v, s.m]
        exact = 1 + self.rods
        if self.mixed:
            parts = [
                np.ascontiguousarray(a).view(np.float32) if k < exact else np.asarray(a, np.float32)
                for k, a in enumerate(parts)
            ]
        rest = np.zeros((len(s.x), self.words * self.numbers - self._used), parts[0].dtype)
        return np.hstack([*parts, rest])

    def decode(self, numbers: np.ndarray) -> States:
        """States of grains, in double."""
        exact = (3 + 4 * self.rods) * (2 if self.mixed else 1)
        first = np.ascontiguousarray(numbers[:, :exact]).view(np.float64)
        v, m = (numbers[:, exact + k : exact + k + 3].astype(np.float64) for k in (0, 3))
        return States(first[:, :3].copy(), v, m, first[:, 3:].copy() if self.rods else None)
