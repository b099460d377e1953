"""Runs and points of a study, as they were measured: every point with its replicates pooled."""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from labbook.fields import Fields
from labbook.fit.outlet import Outlet
from labbook.measure import RunData
from labbook.measure.acceleration import AccelerationProfile
from labbook.measure.flow import CUT_SHORT
from labbook.report import display
from labbook.scene import Bodies
from labbook.stats import Measured, Pooled
from labbook.study import Point

FLOW_RATE = "flow_rate"


ORIFICE = "container.orifice"


class Finished(Protocol):
    """A run that has ended, as the catalogue hands it out."""

    @property
    def point(self) -> "Point": ...
    @property
    def seed(self) -> int: ...
    @property
    def run_key(self) -> str: ...
    @property
    def outcome(self) -> str: ...
    @property
    def provenance(self) -> Mapping[str, Any]: ...
    def data(self) -> RunData:
        """What was observed."""
        ...

    def recording(self) -> Mapping[str, np.ndarray] | None:
        """Recorded frames, or None without any."""
        ...


@dataclass(frozen=True, eq=False)
class Trace:
    """W(t) of one run: times [s] and rates [kg/s], shape [n], and start and end [s] of the window of its mean."""

    time: np.ndarray
    rate: np.ndarray
    window: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class RunResult:
    """One run: how it ended, what was measured of it, by quantity, its W(t), and the profiles along its outlet.

    `outlets`: those profiles by definition (`labbook.fit.DEFINITIONS`); `frames` reads what was recorded of it, None if
    nothing was.
    """

    seed: int
    run_key: str
    outcome: str
    measured: Mapping[str, Measured]
    trace: Trace | None
    provenance: Mapping[str, Any]
    outlets: Mapping[str, Outlet] = field(default_factory=dict)
    frames: Callable[[], Mapping[str, np.ndarray] | None] = lambda: None
    acceleration: AccelerationProfile | None = None
    """Above the middle of the outlet, where `orifice` was measured."""
    stress: Callable[[], "tuple[Fields, int] | None"] = lambda: None
    """Fields with the contact stress of the bed, and of how many frames; None unless `contact_stress` was measured."""


@dataclass(frozen=True, eq=False)
class PointResult:
    """One point of a study with its replicates.

    `at`: what was swept, without what follows from the rest; `pooled`: means over seeds, by quantity, with Student
    intervals; `tolerance`: the relative half-width that the study asks for; `asked`: how many replicates it asks for at
    least.
    """

    point: "Point"
    at: Mapping[str, float | str]
    runs: tuple[RunResult, ...]
    pooled: Mapping[str, Pooled]
    tolerance: float | None
    asked: int

    @property
    def label(self) -> str:
        """What was swept, in the units of the field."""
        return display.label(self.at)

    @property
    def orifice(self) -> float:
        """Width of the outlet [m]; NaN where the container has none."""
        return float(getattr(self.point.scene.container, "orifice", math.nan))

    @property
    def flow_rate(self) -> Pooled | None:
        """Pooled W [kg/s], or None if no replicate gave one."""
        return self.pooled.get(FLOW_RATE)

    def outlets(self, definition: str) -> tuple[Outlet, ...]:
        """Profiles along the outlet, of every run that has them."""
        return tuple(run.outlets[definition] for run in self.runs if definition in run.outlets)

    @property
    def outcomes(self) -> Counter[str]:
        """How many replicates ended in which way."""
        return Counter(run.outcome for run in self.runs)

    @cached_property
    def notes(self) -> Counter[str]:
        """How many replicates carry which note on their flow rate (`trending` ...)."""
        carried = (run.measured[FLOW_RATE].notes for run in self.runs if FLOW_RATE in run.measured)
        return Counter(note for notes in carried for note in notes)

    @property
    def trending(self) -> bool:
        """Whether the flow of more than half of the replicates has no plateau."""
        return self.notes["trending"] > len(self.runs) / 2

    @property
    def precise(self) -> bool | None:
        """Whether the pooled flow rate meets the study's tolerance; None if none was asked for."""
        if self.tolerance is None:
            return None
        return self.flow_rate is not None and self.flow_rate.relative <= self.tolerance

    @property
    def partial(self) -> bool:
        """Whether replicates are lacking. Of runs that began together the first to end flow fast: no fair sample."""
        return len(self.runs) < self.asked

    @property
    def remark(self) -> str:
        """What a reader must know of this point, in a few words; empty if nothing."""
        parts = [f"{len(self.runs)} of {self.asked} runs so far"] if self.partial else []
        parts += ["trending"] if self.trending else []
        parts += ["stopped within the window"] if self.notes[CUT_SHORT] else []
        ended = {how: n for how, n in self.outcomes.items() if how in ("clogged", "diverged")}
        return ", ".join(parts + [f"{n} of {len(self.runs)} {how}" for how, n in ended.items()])


def frames_of(finished: "Finished", data: RunData) -> Callable[[], Mapping[str, np.ndarray] | None]:
    """Reads what was recorded of a run; of unlike grains with their `radius` [m] and `kind`, which the start knows."""
    if not data.scene.grains.varied:
        return finished.recording
    bodies, start = Bodies.of(data.scene.grains, data.start), data.start

    def read() -> Mapping[str, np.ndarray] | None:
        table = finished.recording()
        if table is None:
            return None
        which = start.rows(np.asarray(table["id"]))
        return {**table, "radius": bodies.radius[which], "kind": bodies.kind[which]}

    return read
