"""Breaking of arches that stopped the flow: grains above the outlet get random velocities until one leaves."""

import numpy as np

from labbook.scene import Packing, Scene
from labbook.scene.timescales import gravity_time

SPEED = 0.3
"""Speed of the grains in the first push, in sqrt(g d*), and its increase with each further push: contacts dissipate the
energy of slow grains before an arch yields."""
FASTEST = 3.0
"""Largest speed of a push, in sqrt(g d*)."""
STILL = 0.01
"""Speed below which a grain near the outlet counts as still, in sqrt(g d*)."""
PUSHED, LOOKED_AT = 1.5, 2.0
"""Distances from the outlet, in its widths, within which grains are pushed, and within which they have to be still."""
AGAIN = 1.0
"""Time between pushes while no grain leaves, in sqrt(d*/g)."""


class Breaker:
    """Pushes that break the arches of one run."""

    def __init__(self, scene: Scene, seed: int, beat: float):
        """Prepare the pushes of a run.

        Args:
            scene: Scene with `restart` and one outlet.
            seed: Seed of the bed.
            beat: Duration of a beat [s].
        """
        assert scene.restart is not None
        self._scene, self._key = scene, (scene.restart.version, seed)
        self._unit = scene.gravity * gravity_time(scene)
        self._every = max(1, round(AGAIN * gravity_time(scene) / beat))

    def push(self, beats: int) -> int | None:
        """Number, from 1 on, of the push that is due some beats after a restart; None if none is."""
        number, rest = divmod(beats, self._every)
        return None if rest else number + 1

    def pushed(self, there: Packing, beat: int, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Draw velocities of the grains above the outlet.

        Their speed depends on `number`, their random directions on seed and beat.

        Args:
            there: The bed.
            beat: Number of the beat after which grains are pushed.
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
    """True if no grain near the only outlet of a scene moves."""
    near = _within(scene, there, LOOKED_AT)
    limit = STILL * scene.gravity * gravity_time(scene)
    return bool((np.linalg.norm(there.v[near], axis=1) <= limit).all())


def _within(scene: Scene, there: Packing, widths: float) -> np.ndarray:
    """Mask of the grains above the outlet, within a number of its widths."""
    outlet = scene.container.outlets[0]
    height = there.x[:, 2] - outlet.plane
    away = height if outlet.lid is None else np.abs(outlet.lid.distance(there.x))
    return (height > 0) & (away <= widths * outlet.width)
