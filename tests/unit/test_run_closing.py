"""What members of an ensemble leave is written and measured by other threads, while the ensemble goes on."""

import threading
import time

import pytest
from labbook_toy import Backend, Ensemble
from toy_lab import arrays, carry_out, study
from toy_records import outcomes

from labbook.lab import Catalogue
from labbook.lab.folder import DiskFull
from labbook.run import closing, runner
from labbook.run.discharge import DischargeJob
from labbook.run.watch import Unwatched


@pytest.fixture
def together(monkeypatch):
    """One ensemble takes all jobs, and several threads write what they leave, as on a GPU."""
    monkeypatch.setattr(runner, "slots", lambda *_: 100)
    made = closing.Closing
    monkeypatch.setattr(runner, "Closing", lambda board, threads: made(board, 3))


def test_what_is_written_by_other_threads_is_the_same_in_every_bit(tmp_path, together):
    asked = study(tmp_path, "record: {every: 4 ms, replicates: 1}", replicates=4)
    carry_out(asked, tmp_path / "many", lanes=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "slots", lambda *_: 1)
        patch.setattr(runner, "Closing", lambda board, threads: closing.Closing(board, 1))
        carry_out(asked, tmp_path / "one", lanes=1)
    for folder in ("runs", "packings"):
        keys = {path.name for path in (tmp_path / "one" / folder).iterdir()}
        assert keys == {path.name for path in (tmp_path / "many" / folder).iterdir()}
        for key in keys:
            assert arrays(tmp_path / "one" / folder / key) == arrays(tmp_path / "many" / folder / key)
    one, many = (Catalogue(tmp_path / name).measurements() for name in ("one", "many"))
    order = ["run_key", "measure", "quantity"]
    assert one.sort_values(order).to_csv(index=False) == many.sort_values(order).to_csv(index=False)


def test_an_ensemble_goes_on_while_a_run_is_written(tmp_path, together, monkeypatch):
    beats, entered, went_on = [0], [], []
    advance, finish = Ensemble.advance, DischargeJob.finish

    def counted(self, *given):
        beats[0] += 1
        return advance(self, *given)

    def slow(self, verdict, left):
        if not entered:  # the first run to end: others have beats to go
            entered.append(self)
            before, until = beats[0], time.monotonic() + 20
            while beats[0] < before + 2 and time.monotonic() < until:
                time.sleep(0.001)
            went_on.append(beats[0] >= before + 2)
        finish(self, verdict, left)

    monkeypatch.setattr(Ensemble, "advance", counted)
    monkeypatch.setattr(DischargeJob, "finish", slow)
    summary = carry_out(study(tmp_path, orifices="[18, 36]"), tmp_path / "lab", lanes=1)
    assert went_on == [True]
    assert outcomes(summary) == ["finished"] * 4


def test_a_disk_that_is_full_ends_all_and_the_next_command_goes_on(tmp_path, together, monkeypatch):
    asked = study(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("labbook.run.discharge.PICTURE", "/dev/full")
        with pytest.raises(DiskFull):
            carry_out(asked, tmp_path / "lab", lanes=1)
    assert not list((tmp_path / "lab").glob("runs/*"))
    summary = carry_out(asked, tmp_path / "lab", lanes=1)
    assert summary.complete
    for thread in threading.enumerate():
        if thread.name == "labbook-closing":
            thread.join(10)
            assert not thread.is_alive()


def test_jobs_that_hold_too_many_grains_are_waited_for(tmp_path, together, monkeypatch):
    monkeypatch.setattr(closing, "_HELD", 250)  # one job of 200 grains, and no second one
    at_once, most = [0], [0]
    finish = DischargeJob.finish
    lock = threading.Lock()

    def counted(self, verdict, left):
        with lock:
            at_once[0] += 1
            most[0] = max(most[0], at_once[0])
        time.sleep(0.02)
        finish(self, verdict, left)
        with lock:
            at_once[0] -= 1

    monkeypatch.setattr(DischargeJob, "finish", counted)
    assert carry_out(study(tmp_path, replicates=4), tmp_path / "lab", lanes=1).complete
    assert most == [1]


def test_a_run_that_is_written_is_told(tmp_path, together, monkeypatch):
    monkeypatch.setattr(runner, "_LOOK", 0.0)
    monkeypatch.setattr(runner, "_TELLING", float("inf"))
    finish = DischargeJob.finish
    monkeypatch.setattr(DischargeJob, "finish", lambda *given: (time.sleep(0.05), finish(*given))[1])
    seen = set()

    class Watch(Unwatched):
        def show(self, view):
            seen.update((one.phase, one.says) for one in view.going)

    carry_out(study(tmp_path), tmp_path / "lab", watcher=Watch(), lanes=1, backend=Backend())
    assert ("writing", ("writing and measuring",)) in seen
