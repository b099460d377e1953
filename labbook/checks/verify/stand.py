"""The test stand that cases run on: a backend, known by its contract only, in one precision on one device."""

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
    """A case could not be measured: a guard stopped the backend, or what was to be seen did not happen."""


def require(happened: bool, what: str) -> None:
    """Raises NotMeasured unless what the measurement rests on has happened."""
    if not happened:
        raise CaseNotMeasured(what)


@dataclass(frozen=True, eq=False)
class Motion:
    """What became of one member: rows of its probes, how it stands and the packing at the end, its events."""

    scene: Scene
    numerics: Numerics
    tables: Mapping[Probe, Table]
    status: Status
    end: Packing
    events: Sequence[Event]

    def rows(self, probe: Probe) -> Table:
        """Rows of one probe. Raises NotMeasured if there is none."""
        require(len(self.tables[probe]["step"]) > 0, f"there is nothing to read of {probe}")
        return self.tables[probe]

    def by_beat(self, probe: Probe, names: Sequence[str]) -> np.ndarray:
        """Columns `names` of a Sample of grains of which none has left: shape [beats, grains, names]."""
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
    """One member to be: its scene, time step [s] and start, and further numerics."""

    scene: Scene
    dt: float
    packing: Packing
    settled_below: float | None = None
    numerics: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Admitted:
    """Members side by side in an open ensemble: each with its start and numerics."""

    ensemble: Ensemble
    starts: Sequence[MemberStart]
    numerics: Sequence[Numerics]
    members: Sequence[Member]

    def motions(self, events: Sequence[Event]) -> list[Motion]:
        """What has become of the members; `events`: all that have happened to them."""
        tables = self.ensemble.drain()
        return [
            Motion(
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
class Stand:
    """A backend to be checked."""

    backend: Backend
    precision: str = "double"
    device: str = "cpu"

    def numerics(self, dt: float, **further: Any) -> Numerics:
        """Numerics in the precision of this stand; `dt` [s]."""
        return Numerics.model_validate({"dt": dt, "precision": self.precision, **further})

    def run_all(
        self,
        starts: Sequence[MemberStart],
        beats: int,
        steps_per_beat: int = 1000,
        probes: Sequence[Probe] = (),
        *,
        until_event: bool = False,
    ) -> list[Motion]:
        """Follow members side by side for `beats` beats each; all must need the same Spec.

        A Ledger is always kept, so that cases share compiled kernels. `until_event`: stop at any event of all
        members (they settle, or empty). Raises NotMeasured if a guard stops a member.
        """
        kept = (*probes, *([] if any(isinstance(p, Ledger) for p in probes) else [Ledger(every=beats)]))
        with self.admitted(starts, steps_per_beat, kept) as admitted:
            events: list[Event] = []
            for _ in range(beats) if until_event else (beats,):
                events += admitted.ensemble.advance(1 if until_event else beats)
                if until_event and {event.member for event in events} == set(admitted.members):
                    break
            for event in events:
                require(not isinstance(event, Failed), f"a guard stopped the run: {event}")
            return admitted.motions(events)

    @contextmanager
    def admitted(
        self, starts: Sequence[MemberStart], steps_per_beat: int, probes: Sequence[Probe]
    ) -> Iterator[Admitted]:
        """Members at their starts, in an ensemble of their own; all must need the same Spec."""
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
        self, start: MemberStart, beats: int, steps_per_beat: int = 1000, probes: Sequence[Probe] = (), **how: Any
    ) -> Motion:
        """Follow one member; see `run_all`."""
        return self.run_all([start], beats, steps_per_beat, probes, **how)[0]


def rows_of(table: Table, member: Member) -> Table:
    """The rows of one member."""
    mine = table["member"] == member.index
    return {name: column[mine] for name, column in table.items()}


def grains_at(x: Any, v: Any = None, omega: Any = None) -> Packing:
    """A packing of grains at `x` [m] with velocities `v` [m/s] and `omega` [rad/s], at rest where not given."""
    x = np.atleast_2d(np.asarray(x, float))
    zero = np.zeros_like(x)
    return Packing(
        x=x,
        v=zero if v is None else np.broadcast_to(v, x.shape),
        omega=zero if omega is None else np.broadcast_to(omega, x.shape),
    )
