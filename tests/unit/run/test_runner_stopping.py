"""`labbook run` asked to stop: it answers at once, saves what there is to save, and leaves at once when asked again."""

import os
import pty
import select
import signal
import subprocess
import threading
import time

import labbook_toy
import pytest
from toy_lab import carry_out, labbook, start, study, study_file
from toy_records import records

from labbook.run.stopping import SAVING, StopRequest

BACKEND = ("--backend", "toy")


class ActiveJob:
    """`labbook run` in a process of its own, and when it wrote which line to standard error."""

    def __init__(self, *words: object, **given):
        self.process = start("run", *words, *BACKEND, **given)
        self.lines: list[tuple[float, str]] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append((time.monotonic(), line))

    def heard(self, words: str, within: float = 60.0) -> float:
        """When it wrote these words."""
        deadline = time.monotonic() + within
        while time.monotonic() < deadline:
            for when, line in self.lines:
                if words in line:
                    return when
            time.sleep(0.01)
        raise AssertionError(f"no {words!r} within {within} s in {self.lines}")

    def ask(self, number: signal.Signals) -> float:
        """Send a signal; when."""
        self.process.send_signal(number)
        return time.monotonic()

    def ended(self, within: float) -> tuple[float, str]:
        """When it ended, and what is on standard output. Fails if that takes longer."""
        try:
            self.process.wait(timeout=within)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
        when = time.monotonic()
        self._reader.join(5)
        assert self.process.stdout is not None
        return when, self.process.stdout.read()


SOON = 1.0
"""Seconds in which a signal must be answered."""
LONG = "120"
"""Seconds that nothing may wait for."""


LIKEWISE = [pytest.param(number, marks=pytest.mark.slow) for number in (signal.SIGTERM, signal.SIGHUP)]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, *LIKEWISE])
def test_while_kernels_compile_there_is_nothing_to_wait_for(tmp_path, number):
    going = ActiveJob(study_file(tmp_path), "--lab", tmp_path / "lab", LABBOOK_TOY_COMPILES=LONG)
    going.heard("compiling, once for this kind of scene")
    asked = going.ask(number)
    ended, out = going.ended(within=20)
    assert ended - asked < 3, "some of which is the end of Python"
    assert going.process.returncode == 130
    assert going.heard(SAVING, 1) - asked < SOON
    assert "the same command goes on from here" in out
    labbook("run", study_file(tmp_path), "--lab", tmp_path / "lab", *BACKEND)
    assert len(records(tmp_path / "lab")) == 4, "nothing is held by what was left behind"


@pytest.mark.slow
def test_asked_again_within_a_long_beat_it_leaves_at_once_and_keeps_the_last_save(tmp_path):
    lab, path = tmp_path / "lab", study_file(tmp_path, orifices="[24]", replicates=1)
    carry_out(study(tmp_path, "stop: {max_time: 4 ms}", orifices="[24]", replicates=1), lab)
    going = ActiveJob(study_file(tmp_path, orifices="[24]", replicates=1), "--lab", lab, LABBOOK_TOY_PAUSE=LONG)
    going.heard(labbook_toy.PAUSING)  # asked between two beats it would end after the first request
    first = going.ask(signal.SIGINT)
    assert going.heard(SAVING, 10) - first < SOON
    time.sleep(0.5)
    assert going.process.poll() is None, "it waits for the end of the beat"
    second = going.ask(signal.SIGINT)
    ended, _ = going.ended(within=20)
    assert ended - second < SOON
    assert going.process.returncode == 130
    going.heard("the last checkpoints are kept", 1)
    labbook("run", path, "--lab", lab, *BACKEND)
    (record,) = records(lab).values()
    assert record.outcome == "finished"
    assert len(record.sessions) == 2, "it went on from where it had been"


@pytest.mark.slow
def test_a_terminal_that_goes_away_saves_what_is_going_on(tmp_path):
    lab, path = tmp_path / "lab", study_file(tmp_path, count=100)
    ours, theirs = pty.openpty()
    process = start("run", path, "--lab", lab, *BACKEND, delay=0.3, terminal=theirs, TERM="xterm")
    os.close(theirs)
    deadline = time.monotonic() + 60
    shown = b""
    while b"discharged" not in shown and time.monotonic() < deadline:
        if select.select([ours], [], [], 0.02)[0]:
            shown += os.read(ours, 65536)
    os.close(ours)  # from now on every write to the terminal fails
    process.send_signal(signal.SIGHUP)
    assert process.wait(timeout=30) == 130
    assert list((lab / "work").glob("*/progress.json")), "saved, though no checkpoint was due"
    labbook("run", path, "--lab", lab, *BACKEND, check=False)  # so few grains give no flow rate, which is told by 1
    carry_out(study(tmp_path, count=100), tmp_path / "whole")
    assert records(lab).keys() == records(tmp_path / "whole").keys()


def test_a_hang_up_after_another_signal_is_no_second_request_nor_is_sigterm_at_once(monkeypatch):
    request, told = StopRequest(), []
    with request.listening(told.append):
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGHUP, signal.SIGTERM):
            os.kill(os.getpid(), number)
            time.sleep(0.05)
        assert request.requested
        monkeypatch.setattr("labbook.run.stopping.SIGTERM_WINDOW", 0.1)  # batch systems send it again within moments
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
    assert told == [SAVING]


def test_a_hang_up_that_is_ignored_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        request = StopRequest()
        with request.listening(print):
            os.kill(os.getpid(), signal.SIGHUP)
            time.sleep(0.05)
        assert not request.requested
    finally:
        signal.signal(signal.SIGHUP, before)
