"""A lab against a model of it, through whatever may happen to it in any order.

Processes run studies, are asked to stop, are killed at any operation on files, or work two at a time; studies are
extended; labs are imported; the index is deleted; finished runs and packings are damaged. The model knows what every
run must be, bit for bit, from labs that nothing happened to.
"""

import os
import shutil
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable
from functools import cache
from pathlib import Path

import labbook_toy
import numpy as np
import pytest
from fragile_disk import KILLED, Disk, ending
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test
from toy_lab import carry_out, content, leftovers, study, within

from labbook.lab import Catalogue, LabFolder, RunRecord, Unreadable
from labbook.lab.folder import EVALUATION
from labbook.lab.index import Index
from labbook.lab.merge import merge
from labbook.lab.packings import PackingRecord
from labbook.lab.runs import open_run
from labbook.lab.tables import read_table

DURATIONS = (0.004, 0.02, 10.0)
"""For how long studies go on [s]: the last of them until the silo is empty enough."""
MOST = 2
"""Replicates."""
FAILED = 3
"""Exit status of a process with an exception."""


@cache
def asked(duration: float, replicates: int):
    """The study; only how long it goes on and its replicates differ."""
    with tempfile.TemporaryDirectory() as folder:
        return study(
            Path(folder), f"stop: {{max_time: {duration} s}}", "record: {every: 4 ms, replicates: 1}", count=40,
            orifices="[18, 24]", replicates=replicates,
        )  # fmt: skip


class Truth:
    """What comes of a study to which nothing happens: all that is in its folders, and all numbers."""

    def __init__(self, duration: float):
        with tempfile.TemporaryDirectory() as folder:
            lab = LabFolder(Path(folder) / "lab")
            carry_out(asked(duration, MOST), lab.folder)
            self.content = content(lab.folder)
            self.runs = {path.name: RunRecord.read(path) for path in lab.runs.iterdir()}
            self.tables = {path.name: tables(path) for path in lab.runs.iterdir()}
            self.numbers = numbers(lab)


truth = cache(Truth)


def tables(run: Path) -> dict[str, dict[str, np.ndarray]]:
    """What a run observed, by file."""
    files = sorted(path for path in run.glob("*.npz") if path.name in ("crossing.npz", "recording.npz"))
    return {path.name: read_table(path) for path in files}


def until(step: int, table: dict[str, np.ndarray]) -> dict[str, bytes]:
    """The rows of a table up to a step, bit for bit."""
    return {name: column[table["step"] <= step].tobytes() for name, column in table.items()}


def numbers(lab: LabFolder) -> dict[str, dict[str, object]]:
    """All measured numbers, by run and quantity, as text: NaN equals itself then."""
    catalogue = Catalogue(lab)
    try:
        rows = catalogue.measurements()
    finally:
        catalogue.close()
    found: dict[str, dict[str, object]] = {}
    for key, quantity, *number in rows[["run_key", "quantity", "value", "error"]].itertuples(index=False):
        found.setdefault(key, {})[quantity] = repr(number)
    return found


def forked(do: Callable[[], object]) -> int:
    """Do it in a process of its own, which is not waited for: its number."""
    process = os.fork()
    if process:
        return process
    try:
        do()
    except BaseException:
        traceback.print_exc(file=sys.__stderr__)
        os._exit(FAILED)
    os._exit(0)


def ended(process: int) -> int:
    """Exit status of a process, once it has ended."""
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


class Stopped(labbook_toy.Backend):
    """Asks its process to stop after so many beats, as a batch system does."""

    def __init__(self, beats: int):
        super().__init__()
        self._beats = beats

    def open(self, spec, slots=None, device="cpu"):
        ensemble = super().open(spec, slots, device)
        drain = ensemble.drain

        def counted():
            self._beats -= 1
            if self._beats == 0:
                os.kill(os.getpid(), signal.SIGTERM)
            return drain()

        ensemble.drain = counted
        return ensemble


LABS = st.sampled_from("ab")
LASTING = st.sampled_from(DURATIONS)
REPLICATES = st.integers(1, MOST)
OPERATIONS = st.integers(1, 400)
LEFT = st.none() | st.floats(0, 1, exclude_max=True)


class LabAndModel(RuleBasedStateMachine):
    """Two labs, what they must have, and what may lie about in them."""

    def __init__(self):
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="labbook-model-"))
        self.labs = {name: LabFolder(self.folder / name) for name in "ab"}
        self.least: dict[str, dict[str, float]] = {name: {} for name in "ab"}
        """How long each run goes on at least [s], by lab and key: longer runs win."""
        self.damaged: dict[str, set[str]] = {name: set() for name in "ab"}
        """Keys of runs and packings that may be damaged."""
        self.unfinished: dict[str, bool] = dict.fromkeys("ab", False)
        """Whether unfinished work may be there."""
        self.killed: dict[str, bool] = dict.fromkeys("ab", False)
        """Whether a process was killed there, so that anything may lie about."""

    def teardown(self):
        try:
            for name in "ab":
                self.run(name, DURATIONS[-1], MOST)
                self.look()
                assert leftovers(self.labs[name].folder) == []
                assert content(self.labs[name].folder).keys() == truth(DURATIONS[-1]).content.keys()
        finally:
            shutil.rmtree(self.folder)

    # what happens

    @rule(lab=LABS, duration=LASTING, replicates=REPLICATES)
    def run(self, lab: str, duration: float, replicates: int):
        """A run to its end: the first one, one that goes on, one that mends, or one with nothing to do."""
        with within(120):
            summary = carry_out(asked(duration, replicates), self.labs[lab].folder, workers=1, checkpoint_every=0)
        assert summary.complete, summary
        self._finished(lab, duration, replicates)

    @rule(lab=LABS, duration=LASTING, beats=st.integers(1, 12))
    def stop(self, lab: str, duration: float, beats: int):
        """A slice of a run: it is asked to stop, and saves."""
        with within(120):
            assert ended(forked(lambda: self._carried_out(lab, duration, backend=Stopped(beats)))) == 0
        self.unfinished[lab] = True

    @rule(lab=LABS, duration=LASTING, operation=OPERATIONS)
    def kill(self, lab: str, duration: float, operation: int):
        """A run is killed at some operation on files, if it comes so far."""
        with within(120):
            status = ended(forked(lambda: self._cut_short(lab, duration, operation)))
        assert status in (0, KILLED)
        self.killed[lab] |= status == KILLED
        if status == 0:
            self._finished(lab, duration, MOST)

    @rule(lab=LABS, duration=LASTING, other=LASTING, operation=st.none() | OPERATIONS)
    def two_runners(self, lab: str, duration: float, other: float, operation: int | None):
        """Two processes at once, of which one may be killed."""
        with within(120):
            one = forked(lambda: self._carried_out(lab, duration))
            two = forked(lambda: self._cut_short(lab, other, operation or 10**9))
            statuses = ended(one), ended(two)
        assert statuses[0] == 0
        assert statuses[1] in ((0,) if operation is None else (0, KILLED))
        self._finished(lab, duration, MOST)
        if statuses[1] == 0:
            self._finished(lab, other, MOST)
        else:
            self.killed[lab] = True

    @rule(lab=LABS, operation=st.none() | st.integers(1, 120))
    @precondition(lambda self: all(lab.exists for lab in self.labs.values()))
    def bring(self, lab: str, operation: int | None):
        """The other lab is imported, by a process that may be killed."""
        other = "ab".replace(lab, "")

        def take():
            with Disk(self.labs[lab].folder, ending(operation or 10**9)):
                index = Index(self.labs[lab])
                merge(index, self.labs[other].folder)
                index.close()

        with within(120):
            status = ended(forked(take))
        assert status in ((0,) if operation is None else (0, KILLED))
        if status:
            self.killed[lab] = True
            return
        for key, duration in self.least[other].items():
            whole = key not in self.damaged[other] and truth(10.0).runs[key].packing_key not in self.damaged[other]
            if whole:
                self._at_least(lab, key, duration)
                self.damaged[lab].discard(key)

    @rule(lab=LABS)
    def forget(self, lab: str):
        """The index is deleted."""
        for path in self.labs[lab].folder.glob("catalogue.db*"):
            path.unlink()

    @rule(lab=LABS, kind=st.sampled_from(["runs", "packings"]), which=st.integers(0, 999), left=LEFT)
    def damage(self, lab: str, kind: str, which: int, left: float | None):
        """A file of a finished run, or of a packing, is deleted, or only a part of it is left."""
        files = [
            path for path in sorted((self.labs[lab].folder / kind).glob("*/*")) if path.suffix in (".json", ".npz")
        ]
        files = [path for path in files if not path.name.startswith(EVALUATION)]
        if not files:
            return
        file = files[which % len(files)]
        if left is None:
            file.unlink()
        else:
            os.truncate(file, int(left * file.stat().st_size))
        self.damaged[lab].add(file.parent.name)
        self.least[lab].pop(file.parent.name, None)

    # what must be so

    @invariant()
    def look(self):
        """Whatever happened, the labs can be opened, and have what they must."""
        for name, lab in self.labs.items():
            if not lab.exists:
                assert not self.least[name]
                continue
            Index(lab).close()
            found = self._look_at_runs(name, lab)
            catalogue = Catalogue(lab)
            outcomes = dict(zip(*catalogue.runs(limit=None)[["run_key", "outcome"]].to_numpy().T, strict=True))
            catalogue.close()
            assert {key for key, outcome in outcomes.items() if outcome != "unreadable"} == found.keys()
            known = numbers(lab)
            for key, right in found.items():
                assert right is None or known[key] == right, "every number is the model's"
            self._look_for_leftovers(name, lab)

    def _look_at_runs(self, name: str, lab: LabFolder) -> dict[str, dict[str, object] | None]:
        """Runs that can be read, with what is measured of them if the model knows it."""
        there, found = content(lab.folder), {}
        every = truth(DURATIONS[-1])
        for key, least in self.least[name].items():
            assert key in there or key in self.damaged[name], f"{key} goes on for {least} s"
        for key in there:
            assert key in every.content, "no folder but those of runs and packings, by their keys"
            packing = every.runs[key].packing_key if key in every.runs else key
            if {key, packing} & self.damaged[name]:
                try:
                    _ = open_run(lab.run(key)) if key in every.runs else None
                except Unreadable:
                    continue
            if key not in every.runs:
                if key not in self.damaged[name]:
                    assert there[key] == every.content[key], "every packing is the model's"
                continue
            had = open_run(lab.run(key))[0].coverage
            right, steps = truth(had.stop.max_time), every.tables[key]
            for file, table in tables(lab.run(key)).items():
                assert until(had.steps, table) == until(had.steps, steps[file]), "every run begins as the model's"
                assert max(table["step"], default=0) <= had.steps
            assert had.duration >= self.least[name].get(key, 0.0), "the longer run wins"
            found[key] = None
            if had.duration == right.runs[key].coverage.duration:  # else what was left of a longer one was gone on with
                assert there[key] == right.content[key], "every run is the model's"
                found[key] = right.numbers[key]
        return found

    def _look_for_leftovers(self, name: str, lab: LabFolder) -> None:
        left = leftovers(lab.folder)
        if not self.killed[name]:
            assert not [path for path in left if (lab.folder / path).is_file() and "/" not in path[5:]], "no locks"
            assert not [path for path in left if path.endswith(".part")], "no temporary files"
            assert self.unfinished[name] or left == [], "no unfinished work"
        for folder in lab.works.glob("*/replaced"):
            kind = lab.runs if (folder / RunRecord.FILE).exists() else lab.packings
            whole = (folder / RunRecord.FILE).exists() or (folder / PackingRecord.FILE).exists()
            assert (kind / folder.parent.name).exists() or not whole, "no run is out of its place"

    # what the model learns

    def _carried_out(self, lab: str, duration: float, **options) -> None:
        carry_out(asked(duration, MOST), self.labs[lab].folder, workers=1, checkpoint_every=0, **options)

    def _cut_short(self, lab: str, duration: float, operation: int) -> None:
        with Disk(self.labs[lab].folder, ending(operation)):
            self._carried_out(lab, duration)

    def _finished(self, lab: str, duration: float, replicates: int) -> None:
        for key, record in truth(duration).runs.items():
            if record.seed <= replicates:
                self._at_least(lab, key, record.coverage.duration)
                self.damaged[lab] -= {key, record.packing_key}
        if (duration, replicates) == (DURATIONS[-1], MOST):
            self.killed[lab] = self.unfinished[lab] = False

    def _at_least(self, lab: str, key: str, duration: float) -> None:
        self.least[lab][key] = max(duration, self.least[lab].get(key, 0.0))


@pytest.mark.parametrize(
    ("examples", "steps"),
    [pytest.param(4, 8, marks=pytest.mark.slow), pytest.param(20, 30, marks=pytest.mark.ring)],
)
def test_whatever_happens_the_lab_is_as_its_model(examples, steps):
    checks = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]
    phases = set(Phase) - {Phase.shrink}  # which takes many minutes; what failed is told as it was
    bounds = settings(
        max_examples=examples, stateful_step_count=steps, deadline=None, suppress_health_check=checks, phases=phases
    )
    run_state_machine_as_test(LabAndModel, settings=bounds)
