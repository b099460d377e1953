"""Arches that stopped the flow are broken: grains above the outlet get random velocities until one leaves."""

import numpy as np

from labbook.scene import Packing, Scene
from labbook.scene.timescales import gravity_time

SPEED = 0.3
"""Of the grains that are pushed first, in sqrt(g d*), and by how much each further push is faster: contacts take the
energy of slow grains before an arch gives way."""
FASTEST = 3.0
"""Of grains that are pushed, at most, in sqrt(g d*)."""
STILL = 0.01
"""Speed below which a grain near the outlet counts as still, in sqrt(g d*)."""
PUSHED, LOOKED_AT = 1.5, 2.0
"""Distance from the outlet, in its widths, within which grains are pushed, and within which they have to be still."""
AGAIN = 1.0
"""Time after which grains are pushed again if none has left, in sqrt(d*/g)."""


class Breaker:
    """Breaks the arches of one run."""

    def __init__(self, scene: Scene, seed: int, beat: float):
        """Take up a run.

        Args:
            scene: With `restart` and one outlet.
            seed: Of the bed.
            beat: Duration of a beat [s].
        """
        assert scene.restart is not None
        self._scene, self._key = scene, (scene.restart.version, seed)
        self._unit = scene.gravity * gravity_time(scene)
        self._every = max(1, round(AGAIN * gravity_time(scene) / beat))

    def push(self, beats: int) -> int | None:
        """Number of the push that is due so many beats after a restart, from 1 on; None if none is."""
        number, rest = divmod(beats, self._every)
        return None if rest else number + 1

    def pushed(self, there: Packing, beat: int, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Draw velocities of the grains above the outlet; seed and beat alone decide what is drawn.

        Args:
            there: The bed.
            beat: Number of the beat after which they are pushed.
            number: Number of the push since the restart, from 1 on.

        Returns:
            Ids of the grains, shape [m], and their velocities [m/s], shape [m, 3]: of one speed, in directions that are
            uniform on the sphere, or on the circle in a bed that lies in one plane y = const.
        """
        assert there.ids is not None
        ids = np.sort(there.ids[_within(self._scene, there, PUSHED)])
        v = np.random.default_rng([*self._key, beat]).normal(size=(len(ids), 3))
        if not np.ptp(there.x[:, 1]):
            v[:, 1] = 0.0
        speed = min(SPEED * number, FASTEST) * self._unit
        return ids, speed * v / np.linalg.norm(v, axis=1, keepdims=True)


def still(scene: Scene, there: Packing) -> bool:
    """Decide if no grain near the only outlet of a scene moves any more."""
    near = _within(scene, there, LOOKED_AT)
    limit = STILL * scene.gravity * gravity_time(scene)
    return bool((np.linalg.norm(there.v[near], axis=1) <= limit).all())


def _within(scene: Scene, there: Packing, widths: float) -> np.ndarray:
    """Mask of the grains above the outlet, within so many of its widths."""
    outlet = scene.container.outlets[0]
    height = there.x[:, 2] - outlet.plane
    away = height if outlet.lid is None else np.abs(outlet.lid.distance(there.x))
    return (height > 0) & (away <= widths * outlet.width)
