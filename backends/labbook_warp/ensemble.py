"""Members of one Spec, stepped side by side on one device."""

import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
import warp as wp
from labbook_dem import ensemble
from labbook_dem.ensemble import explain
from labbook_dem.reading import looking

from labbook.backend import Capabilities, Checkpoint, EndState, Event, Load, Member, Spec
from labbook.backend.numerics import Numerics
from labbook.scene import BedTop, Scene
from labbook.scene.packing import Packing
from labbook_warp.kernels.words import MOST_GRAINS, NO_FAILURE, NO_NUMBER
from labbook_warp.reading import ReadableRun
from labbook_warp.report import Report
from labbook_warp.run import Run
from labbook_warp.spec import most_parts, specialise
from labbook_warp.stage import Stage
from labbook_warp.stored import check
from labbook_warp.traffic import weigh
from labbook_warp.view import DeviceView

GUARDS = {0: "state", 1: "speed", 2: "state", 3: "overlap"}


class Ensemble(ensemble.Ensemble[ReadableRun]):
    """Members on one device; see `labbook.backend.Ensemble`. They get their slots together at the first use of one of
    them."""

    def __init__(
        self, capabilities: Capabilities, spec: Spec, device: wp.Device, slots: int | None, lanes: int | None
    ):  # fmt: skip
        super().__init__(capabilities, spec)
        self._stage = Stage(capabilities, spec, device, slots or 0, lanes)
        self._view = DeviceView(self._stage)

    def _specialise(self, scene: Scene, numerics: Numerics) -> Spec:
        # springs at walls lie as the kernels of this ensemble have them, which may have further kinds of walls in
        return specialise(self._can, scene, numerics, self._spec.probes, parts=most_parts(self._spec))

    def _begin(self, scene: Scene, numerics: Numerics, start: Packing | Checkpoint) -> ReadableRun:
        if isinstance(start, Checkpoint):
            check(self._can, self._spec, scene, numerics, start)
        run = ReadableRun(scene, numerics, self._spec.probes, start, view=self._view)
        self._stage.wait(run)
        return run

    def advance(self, beats: int = 1) -> Sequence[Event]:
        """Take `beats` beats with every member; failed and empty ones rest.

        Raises:
            MemoryError: larger arrays do not fit.
        """
        with self._stage.within_memory():
            return self._advance(beats)

    def _advance(self, beats: int) -> Sequence[Event]:
        self._stage.seat()
        events: list[Event] = []
        for _ in range(beats):
            active = self._going()
            if not active:
                break
            self._stage.close_up()
            self._beat(list(active.values()))
            with self._reading(active.values()):
                self._keep(self._observed(active))
                for member, run in active.items():
                    events += self._events(member, run)
        return events

    def _reading(self, runs: Collection[ReadableRun]) -> AbstractContextManager[None]:
        """Return a context in which data of these runs are copied together."""
        return self._stage.arrays.reading([run.slot for run in looking(runs, self._spec.steps_per_beat)])

    def _beat(self, runs: list[ReadableRun]) -> None:
        """Take a beat with these members.

        A late list may cause a false failure: a grain runs into another one unseen. So a failure counts only if it
        happens again with lists checked at every step.
        """
        failed = self._try_beat(runs)
        if failed:
            with self._stage.checking_every_step():
                for run, word in self._try_beat(list(failed)).items():
                    self._set_failure(run, word)

    def _try_beat(self, runs: list[ReadableRun]) -> Mapping[ReadableRun, int]:
        """Take a beat with these members, and repeat it for those whose lists were late or too short.

        Returns:
            Failures of the members that failed, which are back at the beginning of the beat.
        """
        stage, failed = self._stage, {}
        while runs:
            report = self._take(runs)
            to_repeat = []
            for run in runs:
                report_of_slot = report[run.slot]
                if report_of_slot.valid:
                    run.left = report_of_slot.left
                    run.step += self._spec.steps_per_beat
                    run.crossed = report.crossings(run.slot)
                    run.crossed[:, 0] //= run.per_grain  # kernels know ids of rows
                    continue
                if report_of_slot.fail == NO_FAILURE:
                    to_repeat.append(run)
                else:
                    failed[run] = report_of_slot.fail
                stage.restore(run)
            if any(report[run.slot].late for run in to_repeat):
                stage.check_more_often()
            elif all(report[run.slot].valid for run in runs):
                stage.was_calm()
            stage.make_room(report, to_repeat)
            runs = to_repeat
        return failed

    def _take(self, runs: Sequence[ReadableRun]) -> Report:
        """Take a beat with these members, and read the frames that are due within it."""
        due: dict[int, list[ReadableRun]] = defaultdict(list)
        for run in runs:
            run.frames.clear()
            for step in run.frame_steps():
                due[step - run.step].append(run)
        stops = iter(sorted(due))

        def look() -> None:
            runs_to_read = due[next(stops)]
            with self._stage.arrays.reading([run.slot for run in runs_to_read]):
                for run in runs_to_read:
                    run.take_frames()

        return self._stage.beat(runs, sorted(due), look)

    def _set_failure(self, run: Run, word: int) -> None:
        # The step stands in the highest bits: the smallest word, which kernels keep, is of the first failure.
        step, guard, grain = word >> 26, GUARDS[word >> 24 & 3], word & (MOST_GRAINS - 1)
        value, grain = self._stage.bad_value(run, grain), grain // run.per_grain
        value = math.inf if value > NO_NUMBER else value
        message = explain(guard, grain, step, value, run.scene, run.numerics)
        run.failure = ensemble.Failure(guard, step, grain, message)

    def retire(self, member: Member) -> None:
        """Drop a member and free its slot."""
        self._stage.leave(self._runs[member])
        super().retire(member)

    def end_state(self, member: Member) -> EndState:
        """Return the state of a member that ends here; see `labbook.backend.Ensemble`."""
        return self._runs[member].end_state()

    def reading(self, members: Collection[Member]) -> AbstractContextManager[None]:
        """Return a context in which these members are read together; see `labbook.backend.Ensemble`."""
        self._stage.seat()
        return self._stage.arrays.reading([self._runs[member].slot for member in members])

    def bed(self, member: Member) -> Packing:
        """See `labbook.backend.Ensemble`."""
        run = self._runs[member]
        grains = run.look()
        varied: dict[str, Any] = grains.bodies.carried(run.scene.grains) if grains.bodies else {}
        return Packing(x=grains.x, v=grains.v, omega=grains.w, q=grains.q, ids=grains.ids, **varied)

    def tops(self, heights: Mapping[Member, float]) -> Mapping[Member, BedTop]:
        """See `labbook.backend.Ensemble`."""
        tops = self._view.tops({self._runs[member]: height for member, height in heights.items()})
        return dict(zip(heights, tops, strict=True))

    def _put_back(self, returning: Sequence[tuple[ReadableRun, Packing, np.ndarray]]) -> None:
        self._view.put_back(returning)

    def load(self) -> Load:
        """Cost of a grain-step now; see `labbook.backend.Load`."""
        return weigh(self._stage)

    def close(self) -> None:
        """Free the device's memory."""
        super().close()
        self._view.close()
        self._stage.close()
