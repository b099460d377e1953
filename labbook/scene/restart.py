"""Restarting the flow of a silo after an arch has stopped it."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from labbook.scene.model import Model
from labbook.scene.quantities import Duration


class Restart(Model):
    """Restart of a flow that has stopped; only of fed beds."""

    version: ClassVar[int] = 1
    """Part of the key of every run with restarts; it rises whenever a seed breaks arches in another way."""

    kind: Literal["break"]
    """`break`: grains within 1.5 D of the outlet get random velocities, until one leaves: 0.3 `√(g d*)`, and
    every `√(d*/g)` by as much more, up to 3 `√(g d*)`."""
    wait: Annotated[Duration | None, Field(exclude_if=lambda wait: wait is None)] = None
    """Time without a leaving grain after which the flow counts as stopped, if no grain within 2 D of the outlet is
    faster than 0.01 `√(g d*)`."""
