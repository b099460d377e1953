"""Members of one Spec, stepped side by side on one device."""

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
import warp as wp
from labbook_dem.guards import explain

from labbook.backend import (
    Capabilities,
    Checkpoint,
    Crossing,
    Emptied,
    Event,
    Failed,
    Load,
    Member,
    Probe,
    Settled,
    Spec,
    Status,
    Table,
    empty_table,
)
from labbook.numerics import Numerics
from labbook.protocol.packing import Packing
from labbook.scene import Scene
from labbook_warp.kernels.words import NO_FAILURE
from labbook_warp.reading import read
from labbook_warp.run import Run
from labbook_warp.specialise import specialise
from labbook_warp.stage import Stage, Tuning
from labbook_warp.traffic import weigh

GUARDS = {1: "state", 2: "speed", 3: "overlap"}


class Ensemble:
    """See `labbook.backend.Ensemble`. Members get their slots, all at once, when something is first asked of them."""

    def __init__(self, capabilities: Capabilities, spec: Spec, device: wp.Device, slots: int | None, tuning: Tuning):
        self._can, self._spec = capabilities, spec
        crossings = any(isinstance(probe, Crossing) for probe in spec.probes)
        self._stage = Stage(capabilities, spec, device, slots or 0, crossings, tuning)
        self._runs: dict[Member, Run] = {}
        self._rows: dict[Probe, list[Table]] = defaultdict(list)
        self._next = 0

    def admit(
        self,
        scene: Scene,
        numerics: Numerics,
        start: Packing | Checkpoint,
        *,
        settled_below: float | None = None,
        settled_beats: int = 3,
    ) -> Member:
        """Add a member. Raises ValueError if it needs another Spec than this ensemble's."""
        if specialise(self._can, scene, numerics, self._spec.probes) != self._spec:
            raise ValueError("this member needs another specialisation than the ensemble's")
        if isinstance(start, Checkpoint):
            self._stage.check(start)
        run = Run(scene, numerics, self._spec.probes, start, settled_below, settled_beats)
        member = Member(self._next)
        self._next += 1
        self._runs[member] = run
        self._stage.wait(run)
        return member

    def advance(self, beats: int = 1) -> Sequence[Event]:
        """Let every member take `beats` beats; those that failed or emptied rest."""
        self._stage.seat()
        events: list[Event] = []
        for _ in range(beats):
            going = {member: run for member, run in self._runs.items() if run.going}
            if not going:
                break
            crossings = self._beat(list(going.values()))
            for member, run in going.items():
                events += self._after(member, run, crossings)
        return events

    def _beat(self, runs: list[Run]) -> np.ndarray:
        """Take a beat with these members; those whose lists were short or late take it again. Rows of crossings."""
        stage, rows = self._stage, []
        again = runs
        while again:
            now, again = again, []
            report = stage.beat(now)
            good = []
            if any(report[run.slot].late for run in now):
                stage.check_oftener()
            for run in now:
                said = report[run.slot]
                if said.fail != NO_FAILURE:
                    self._fails(run, said.fail)
                elif said.late or said.crowded:
                    again.append(run)
                else:
                    good.append(run.slot)
                    run.left = said.left
                    run.step += self._spec.steps_per_beat
                    continue
                stage.restore(run)
            rows.append(report.crossings[np.isin(report.crossings[:, 0], good)])
            stage.make_room(report, again)
        return np.concatenate(rows)

    def _fails(self, run: Run, word: int) -> None:
        step, guard, grain = word >> 26, GUARDS[word >> 24 & 3], word & 0xFFFFFF
        value = self._stage.bad_value(run, grain)
        run.failure = (guard, step, grain, explain(guard, grain, step, value, run.scene.grains.diameter))

    def _after(self, member: Member, run: Run, crossings: np.ndarray) -> list[Event]:
        """Read the probes that are due, and see what happened."""
        if run.failure:
            guard, step, grain, message = run.failure
            return [Failed(member, guard, step, grain, message)]
        mine = crossings[crossings[:, 0] == run.slot, 1:]
        for probe, table in read(self._stage, run, run.step // self._spec.steps_per_beat, mine).items():
            size = len(table["step"])
            if size:
                self._rows[probe].append({"member": np.full(size, member.index), **table})
        if run.grains == 0:
            return [Emptied(member, run.time)]
        if run.settled_below is not None:
            run.seen = run.seen + 1 if self._stage.status(run).kinetic < run.settled_below else 0
            if run.seen == run.settled_beats:
                return [Settled(member, run.time)]
        return []

    def drain(self) -> Mapping[Probe, Table]:
        """Rows since the last drain, of every declared probe."""
        rows, self._rows = self._rows, defaultdict(list)
        tables = {probe: rows[probe] or [empty_table(probe)] for probe in self._spec.probes}
        return {
            probe: {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
            for probe, parts in tables.items()
        }

    def status(self, member: Member) -> Status:
        """Where a member stands."""
        return self._stage.status(self._runs[member])

    def checkpoint(self, member: Member) -> Checkpoint:
        """The exact state of a member."""
        return self._stage.checkpoint(self._runs[member])

    def packing(self, member: Member) -> Packing:
        """The portable state of a member."""
        return self._stage.packing(self._runs[member])

    def retire(self, member: Member) -> None:
        """Drop a member; its slot is free."""
        self._stage.leave(self._runs.pop(member))

    def load(self) -> Load:
        """What a grain-step comes to now; see `labbook.backend.Load`."""
        return weigh(self._stage)

    def close(self) -> None:
        """Free the device's memory."""
        self._runs.clear()
        self._stage.close()
