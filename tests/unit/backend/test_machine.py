"""The machine that backends run on."""

from itertools import count

import pytest

from labbook.backend import machine


def test_the_pace_of_cores_is_that_of_passes_and_clocks(monkeypatch):
    """Two passes within a second, of which the thread had a core for 0.3 s."""

    class Clocks:
        def __init__(self):
            self._wall, self._used = count(0.0, 0.5), count(0.0, 0.3)

        def perf_counter(self):
            return next(self._wall)

        def thread_time(self):
            return next(self._used)

    monkeypatch.setattr(machine, "time", Clocks())
    pace = machine.pace.__wrapped__(1, seconds=1.0)
    assert pace.share == pytest.approx(0.3)
    assert pace.core == pytest.approx(2 * machine._PASS / 0.3)


def test_the_pace_is_measured_once_for_each_number_of_threads():
    first = machine.pace(2, 0.0)
    assert first.core > 0
    assert 0 < first.share <= 1
    assert machine.pace(2, 0.0) is first
