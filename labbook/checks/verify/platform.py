"""Test platform of the cases: a backend, used through its contract only, in one precision on one device."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from labbook.backend import Backend, Ensemble, Event, Failed, Member, Status
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Ledger, Probe, Table
from labbook.scene import Scene
from labbook.scene.packing import Packing


class CaseNotMeasured(Exception):
    """A case could not be measured: a guard stopped the backend, or the expected motion did not happen."""


def require(happened: bool, message: str) -> None:
    """Raise CaseNotMeasured unless a condition of the measurement holds."""
    if not happened:
        raise CaseNotMeasured(message)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Trajectory of one member: rows of its probes, status and packing at the end, and its events."""

    scene: Scene
    numerics: Numerics
    tables: Mapping[Probe, Table]
    status: Status
    end: Packing
    events: Sequence[Event]

    def rows(self, probe: Probe) -> Table:
        """Return the rows of one probe. Raises CaseNotMeasured if there is none."""
        require(len(self.tables[probe]["step"]) > 0, f"there is nothing to read of {probe}")
        return self.tables[probe]

    def by_beat(self, probe: Probe, names: Sequence[str]) -> np.ndarray:
        """Stack columns of a Sample of grains, none of which has left: shape [beats, grains, names]."""
        table = self.rows(probe)
        steps, first = np.unique(table["step"], return_index=True)
        grains = len(table["step"]) // len(steps)
        require(np.array_equal(first, np.arange(len(steps)) * grains), "a grain has left the scene")
        order = np.lexsort((table["id"], table["step"]))
        return np.stack([table[name][order].reshape(len(steps), grains) for name in names], axis=-1)

    def times(self, probe: Probe) -> np.ndarray:
        """Times [s] at which a probe was read."""
        return np.unique(self.rows(probe)["time"])


@dataclass(frozen=True)
class MemberStart:
    """Start of one member.

    Args:
        scene: Its scene.
        dt: Time step [s].
        packing: Its grains.
        settled_below: Kinetic energy per grain [m g d] below which the member counts as settled; None: never.
        numerics: Further numerical parameters.
    """

    scene: Scene
    dt: float
    packing: Packing
    settled_below: float | None = None
    numerics: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Admitted:
    """Members side by side in an open ensemble, each with its start and numerics."""

    ensemble: Ensemble
    starts: Sequence[MemberStart]
    numerics: Sequence[Numerics]
    members: Sequence[Member]

    def trajectories(self, events: Sequence[Event]) -> list[Trajectory]:
        """Drain the ensemble and collect the course of each member; a second call finds no rows.

        Args:
            events: All events so far.
        """
        tables = self.ensemble.drain()
        return [
            Trajectory(
                scene=start.scene,
                numerics=numerics,
                tables={probe: rows_of(table, member) for probe, table in tables.items()},
                status=self.ensemble.status(member),
                end=self.ensemble.packing(member),
                events=[event for event in events if event.member == member],
            )
            for start, numerics, member in zip(self.starts, self.numerics, self.members, strict=True)
        ]


@dataclass(frozen=True)
class Platform:
    """A backend in one precision on one device, which runs the scenes of cases.

    Args:
        backend: The backend.
        precision: `double` or `mixed`.
        device: One of its devices.
    """

    backend: Backend
    precision: str = "double"
    device: str = "cpu"

    def numerics(self, dt: float, **further: Any) -> Numerics:
        """Build numerics in the precision of this platform; `dt` [s]."""
        return Numerics.model_validate({"dt": dt, "precision": self.precision, **further})

    def run_all(
        self,
        starts: Sequence[MemberStart],
        beats: int,
        steps_per_beat: int = 1000,
        probes: Sequence[Probe] = (),
        *,
        until_event: bool = False,
    ) -> list[Trajectory]:
        """Follow members side by side for `beats` beats each.

        Args:
            starts: Starts of the members; all must need the same Spec.
            beats: Number of beats.
            steps_per_beat: Steps of a beat.
            probes: Probes to read. A Ledger is always added, so that cases share compiled kernels.
            until_event: Stop once every member had an event (it settled, or emptied).

        Returns:
            The trajectory of each member.

        Raises:
            CaseNotMeasured: A guard stopped a member.
        """
        all_probes = (*probes, *([] if any(isinstance(p, Ledger) for p in probes) else [Ledger(every=beats)]))
        with self.admitted(starts, steps_per_beat, all_probes) as admitted:
            events: list[Event] = []
            for _ in range(beats) if until_event else (beats,):
                events += admitted.ensemble.advance(1 if until_event else beats)
                if until_event and {event.member for event in events} == set(admitted.members):
                    break
            for event in events:
                require(not isinstance(event, Failed), f"a guard stopped the run: {event}")
            return admitted.trajectories(events)

    @contextmanager
    def admitted(
        self, starts: Sequence[MemberStart], steps_per_beat: int, probes: Sequence[Probe]
    ) -> Iterator[Admitted]:
        """Open an ensemble with members at their starts, and close it at the end; all must need the same Spec."""
        numerics = [self.numerics(s.dt, steps_per_beat=steps_per_beat, **s.numerics) for s in starts]
        spec = self.backend.specialise(starts[0].scene, numerics[0], probes)
        ensemble = self.backend.open(spec, len(starts), self.device)
        try:
            members = [
                ensemble.admit(start.scene, n, start.packing, settled_below=start.settled_below)
                for start, n in zip(starts, numerics, strict=True)
            ]
            yield Admitted(ensemble, starts, numerics, members)
        finally:
            ensemble.close()

    def run(
        self, start: MemberStart, beats: int, steps_per_beat: int = 1000, probes: Sequence[Probe] = (), **options: Any
    ) -> Trajectory:
        """Follow one member; the arguments are those of `run_all`."""
        return self.run_all([start], beats, steps_per_beat, probes, **options)[0]


def rows_of(table: Table, member: Member) -> Table:
    """Select the rows of one member."""
    mine = table["member"] == member.index
    return {name: column[mine] for name, column in table.items()}


def grains_at(x: Any, v: Any = None, omega: Any = None) -> Packing:
    """Build a packing of grains at `x` [m] with velocities `v` [m/s] and `omega` [rad/s], at rest unless stated."""
    x = np.atleast_2d(np.asarray(x, float))
    zero = np.zeros_like(x)
    return Packing(
        x=x,
        v=zero if v is None else np.broadcast_to(v, x.shape),
        omega=zero if omega is None else np.broadcast_to(omega, x.shape),
    )
