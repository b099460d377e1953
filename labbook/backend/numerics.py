"""Numerical settings of a run, as resolved numbers."""

from typing import Annotated, Literal

from pydantic import Field

from labbook.scene.model import Model
from labbook.scene.quantities import Duration, Ratio, Speed, Whole

Precision = Literal["double", "mixed"]


class Numerics(Model):
    """Time step, precision and neighbour-list settings of one run; part of its key."""

    dt: Duration
    """Time step [s]."""
    precision: Precision = "double"
    """`mixed`: positions and their update in double, contact law in single. If left out, chosen where the
    study states `accuracy.flow_rate`."""
    integrator: Literal["leapfrog"] = "leapfrog"
    skin: Annotated[Ratio, Field(gt=0, le=1)] = 0.15
    """Skin of the neighbour lists, in grain diameters."""
    steps_per_beat: Annotated[Whole, Field(ge=1, le=1_000_000)] = 1000
    """Steps per beat. Measurements are taken and runs are stopped at the ends of beats only."""
    stiffness_scale: Annotated[Ratio, Field(gt=0)] = 1.0
    """Factor on all stiffnesses of the study."""
    speed_limit: Annotated[Speed, Field(gt=0)] = 100.0
    """Abort the run if any grain is faster than this. If a study leaves it out, H is the height of the container, or of
    the column in which grains start, if that is higher."""
    overlap_limit: Annotated[Ratio, Field(gt=0, le=1)] = 0.25
    """Abort the run if any overlap exceeds this fraction of the grain diameter."""

    @property
    def beat(self) -> float:
        """Time between two beats [s]."""
        return self.dt * self.steps_per_beat
