"""A start: grains one above the other in the middle of the container."""

from typing import ClassVar

import numpy as np

from labbook.filling.placing import Start
from labbook.scene import Packing, Scene


class Stack(Start):
    """Equal spheres at rest in a column of one."""

    name: ClassVar[str] = "stack"
    version: ClassVar[int] = 1

    def volume(self, closed: Scene) -> float:
        """That of a cube each."""
        return closed.grains.count * closed.grains.diameter**3

    def place(self, closed: Scene, seed: int) -> Packing:
        """The seed moves grains a little aside, so that they do not balance."""
        n, d = closed.grains.count, closed.grains.diameter
        x = np.random.default_rng([self.version, seed]).uniform(-1e-3 * d, 1e-3 * d, (n, 3))
        x[:, 2] += (1 + np.arange(n)) * d
        return Packing(x=x, v=np.zeros((n, 3)), omega=np.zeros((n, 3)))
