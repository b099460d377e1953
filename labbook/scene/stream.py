"""A stream of grains that enters a scene: through which region, at which rate, how fast and in which order."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field, model_validator

from labbook.scene.grains import Grains
from labbook.scene.model import Fault, Model, refuse
from labbook.scene.quantities import Coordinate, Duration, MassRate, Speed

_Point = tuple[Coordinate, Coordinate, Coordinate]


class Stream(Model):
    """Grains that enter one after another at random free places of a region."""

    rate: MassRate
    """Mass that enters per time, as long as the region has free places."""
    low: _Point
    """Corner of the region with the least x, y and z: grains lie entirely within."""
    high: _Point
    """Corner of the region with the largest x, y and z."""
    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    """Velocity of the grains as they enter."""
    # where they are not stated they are left out of what is stored
    every: Annotated[Duration | None, Field(exclude_if=lambda every: every is None)] = None
    """Time between two batches, each as large as the rate says; none: grains enter at every beat."""
    layers: Annotated[tuple[str, ...], Field(exclude_if=lambda layers: not layers)] = ()
    """Kinds of grains in the order in which they enter, such as `[a, b, a, b]`: grains of a kind are shared equally
    among its layers; none: in random order."""

    def time(self, grains: Grains) -> float:
        """Time [s] in which all grains enter, if sizes are as expected and the region always has room."""
        return grains.count * grains.volume * grains.mean_density / self.rate

    @model_validator(mode="after")
    def _is_possible(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        for axis, low, high in zip("xyz", self.low, self.high, strict=True):
            if high <= low:
                reason = f"the region is empty along {axis}, from {1e3 * low:g} to {1e3 * high:g} mm"
                yield Fault("high", reason, "state the corner with the largest coordinates")
