"""What people see of a run that is going on: on a terminal of 80 columns, and where there is none."""

import math
import re
import time
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from labbook_toy import Backend
from rich.console import Console
from toy_lab import carry_out, labbook, start, study, study_file

from labbook.backend import load
from labbook.backend.numerics import Numerics
from labbook.checks.verify.symmetry import hopper
from labbook.plan.forecast import fill_time
from labbook.run import execution, job_queue, progress
from labbook.run.discharge import DischargeJob
from labbook.run.fill import FillJob, short
from labbook.run.job_queue import Tally
from labbook.run.progress import Bar, fitted, one_line, remaining
from labbook.run.summary import Summary
from labbook.run.watch import ActiveJob, Meter, NullWatcher, View
from labbook.study import load as read

COMPILING = ("compiling, once for this kind of scene",)
SETTLING = ("settling: 3e-4 of m g d, rests below 1e-6", "0.31 of 60 s")


def test_the_rate_at_the_end_leaves_compiling_out():
    tally = Tally(ran={"a": "finished"})
    summary = Summary(tally, (), False, 100.0, 2e8, (), preparing=80.0)
    assert summary.lines()[0].endswith("10.00 M grain-steps/s without 80 s of compiling and loading kernels")
    quick = Summary(tally, (), False, 100.0, 2e8, (), preparing=0.2)
    assert quick.lines()[0].endswith(", 2.00 M grain-steps/s")


def test_time_in_which_all_jobs_wait_for_kernels_is_added_up(monkeypatch):
    clock = iter([0.0, 30.0, 31.0, 50.0, 52.0])
    monkeypatch.setattr("labbook.run.watch.time.perf_counter", lambda: next(clock))
    meter = Meter()
    for idle in (True, True, False, True, False):  # 0 to 31 s and 50 to 52 s
        meter.look(idle)
    assert meter.preparing == 33.0


VIEW = View(
    runs_done=0,
    runs_asked=120,
    fillings_left=2,
    going=(ActiveJob("packing, seed 1", "settling", SETTLING), ActiveJob("packing, seed 2", "settling", SETTLING)),
    elsewhere=0,
    work_done=2e9,
    work_left=6.4e9,
    rate=1e8,
)


def drawn(view: View, width: int) -> list[str]:
    """Lines of the bar on a terminal of so many columns."""
    file = StringIO()
    console = Console(width=width, force_terminal=True, file=file, color_system="standard")
    bar = Bar(console)
    bar.show(view)
    console.print(bar)
    return [line.rstrip() for line in re.sub(r"\x1b\[[0-9;]*[A-Za-z]", "", file.getvalue()).splitlines()]


def test_at_80_columns_there_is_a_bar_and_every_word_is_whole():
    first, *others = drawn(VIEW, 80)
    assert "0/120 runs, 2 packings first" in first
    assert "━" * progress.NARROWEST in first
    assert first.endswith("about 64 s left")
    assert "grain-steps" not in first, "of the words on the right the rate goes first"
    assert others == [
        "  packing, seed 1: settling: 3e-4 of m g d, rests below 1e-6; 0.31 of 60 s",
        "  packing, seed 2: settling: 3e-4 of m g d, rests below 1e-6; 0.31 of 60 s",
    ]
    assert drawn(VIEW, 110)[0].endswith("about 64 s left, 100.0 M grain-steps/s")


@pytest.mark.parametrize("width", [30, 40, 60, 80, 110, 200])
def test_nothing_is_wider_than_the_terminal(width):
    long = ActiveJob("packing of friction 0.1, orifice 24 mm and 11 other points, seed 1", "settling", SETTLING)
    many = tuple(replace(long, label=f"run {k}", phase="discharging") for k in range(30))
    view = replace(VIEW, going=(long, *many), elsewhere=3)
    lines = drawn(view, width)
    assert max(map(len, lines)) < width
    assert len(lines) == 6, "three jobs, how many more, and those elsewhere"
    assert lines[-2:] == ["  and 28 discharging", "  3 held by another process"]


def test_what_there_is_no_room_for_goes_from_its_end():
    label = "packing of friction 0.1, orifice 24 mm, seed 1"
    assert fitted("packing, seed 1", SETTLING, 60) == "packing, seed 1: settling: 3e-4 of m g d, rests below 1e-6"
    assert fitted(label, SETTLING, 70) == "packing of fr…24 mm, seed 1: settling: 3e-4 of m g d, rests below 1e-6"


def test_jobs_that_compile_are_named_in_one_line():
    view = replace(
        VIEW, rate=0.0, going=tuple(ActiveJob(f"packing, seed {k}", "compiling", COMPILING) for k in (1, 2, 3))
    )
    assert drawn(view, 80)[1:] == ["  compiling, once for this kind of scene: packing, seed 1 and 2 more"]
    assert "left" not in drawn(view, 80)[0]


@pytest.mark.parametrize("phase", ["compiling", "preparing", "settling"])
def test_a_line_without_a_terminal_names_three_jobs_of_many(phase):
    going = tuple(ActiveJob(f"packing of orifice {k} mm, seed 1", phase, ("kernels",)) for k in range(240))
    said = one_line(replace(VIEW, going=going), 400)
    assert said.count("orifice") == 3
    more = "and 237 settling" if phase == "settling" else "orifice 2 mm, seed 1 and 237 more"
    assert said.endswith(more)


@pytest.mark.parametrize("width", [60, 80, 112])
def test_a_line_without_a_terminal_is_no_wider_than_asked_and_begins_with_the_counts(width):
    long = ActiveJob("packing of friction 0.1, orifice 24 mm and 11 other points, seed 1", "settling", SETTLING)
    said = one_line(replace(VIEW, going=(long, long, long, long), elsewhere=2), width)
    assert len(said) <= width
    assert said.startswith("0/120 runs, 2 packings first")
    assert "about 64 s left" in said
    assert ("100.0 M grain-steps/s" in said) == (width > 60), "the rate goes before the time left"


@pytest.mark.parametrize(("time", "last", "expected"), [(1.0, 0.95, 0.5), (1.4, 1.0, 1.4 / 1.5), (0.3, 0.0, 0.6)])
def test_a_flow_that_rests_is_forecast_to_end_as_clogged(time, last, expected):
    """Half of the mass that ends the run has left. A flow that rests since `last` ends 0.5 s after it."""
    stop = SimpleNamespace(precise=None, max_time=60.0, stall=0.5)
    job = SimpleNamespace(
        demand=SimpleNamespace(shared=SimpleNamespace(stop=stop)),
        status=SimpleNamespace(time=time),
        _discharged=0.3,
        _target_fraction=0.6,
        _idle_time=time - last,
        _breaker=None,
        _is_pausing=time - last > 0.3 * 0.5,
    )
    assert DischargeJob.progress(job) == pytest.approx(expected)  # pyright: ignore[reportArgumentType]


def test_what_nobody_knows_is_not_forecast():
    soon = replace(VIEW, work_left=1e6)
    assert remaining(soon) == "a few seconds left"
    assert remaining(replace(soon, open_ended=True)) == "time left unknown"
    assert remaining(replace(VIEW, work_left=1e12, open_ended=True)) == "at least 2.8 h left"
    assert remaining(replace(VIEW, rate=0.0)) == ""


@pytest.mark.slow
def test_a_filling_that_takes_longer_than_expected_is_open_ended_and_tells_its_energy(tmp_path, monkeypatch):
    monkeypatch.setattr("labbook_toy.DECAY", 1.0)  # nothing ever rests
    views, demanded, begin = [], [], FillJob.begin
    monkeypatch.setattr(FillJob, "begin", lambda job: demanded.append(job.demand) or begin(job))

    class Watch(NullWatcher):
        def show(self, view: View) -> None:
            views.append(view)

    asked = study(tmp_path, "fill: {max_time: 1500 ms}", replicates=1, orifices="[24]")
    summary = carry_out(asked, tmp_path / "lab", backend=Backend(delay=0.004), watcher=Watch())
    (why,) = summary.tally.failed
    assert "not at rest after 1.5 s" in why
    settling = [(view, going.says) for view in views for going in view.going if going.phase == "settling"]
    assert all(re.fullmatch(r"settling: \S+ of m g d, rests below 1e-6", says[0]) for _, says in settling)
    times = {view.open_ended: float(says[1].split(" of ")[0]) for view, says in settling}
    assert times[False] <= fill_time(demanded[0]) + 0.01, "the last time at which it was still expected to rest"
    assert times[True] > fill_time(demanded[0])


@pytest.mark.slow
def test_an_outlet_that_may_have_clogged_is_told_before_it_counts_as_clogged(tmp_path):
    said = set()

    class Watch(NullWatcher):
        def show(self, view: View) -> None:
            said.update(part for going in view.going for part in going.says)

    asked = study(tmp_path, "stop: {stall: 0.5 s}", orifices="[8]", replicates=1)
    carry_out(asked, tmp_path / "lab", backend=Backend(delay=0.005), watcher=Watch())
    assert any(re.fullmatch(r"no grain for 0\.\d\d s, clogged after 0\.5 s", part) for part in said), said
    assert "33 % discharged, ends at 65 %" in said


@pytest.mark.parametrize(("energy", "shown"), [(12.3, "12"), (0.034, "0.034"), (3.4e-5, "3e-5"), (1e-12, "1e-12")])
def test_energies_are_short(energy, shown):
    assert short(energy) == shown


def test_a_packing_is_named_by_the_points_that_it_serves(tmp_path):
    seen = set()

    class Watch(NullWatcher):
        def show(self, view: View) -> None:
            seen.update(going.label for going in view.going)

    def labels(asked, folder):
        seen.clear()
        carry_out(asked, tmp_path / folder, backend=Backend(delay=0.05), watcher=Watch(), packings_only=True)
        return {label for label in seen if label.startswith("packing")}

    assert labels(study(tmp_path, replicates=1), "shared") == {"packing, seed 1"}
    path = study_file(tmp_path, replicates=1)
    path.write_text(path.read_text().replace("sweep:\n", 'sweep:\n  fill.friction: "[0.1, 0.5]"\n'))
    own = {f"packing of fill.friction {friction}, orifice 18 mm and 1 other point, seed 1" for friction in (0.1, 0.5)}
    assert labels(read(path), "own") == own


def test_without_a_terminal_each_phase_and_every_half_minute_is_a_line(monkeypatch):
    now = 0.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: now)
    file = StringIO()
    bar = Bar(Console(file=file, width=200))
    with bar:
        for second in range(100):
            now = float(second)
            compiling = ActiveJob("packing, seed 1", "compiling", COMPILING)
            bar.show(replace(VIEW, rate=0.0, going=(compiling,)) if second < 20 else VIEW)
        bar.tell("stopping")
    lines = file.getvalue().splitlines()
    assert [line.split(":")[0].strip() for line in lines] == ["0 s", "20 s", "50 s", "80 s", "stopping"]
    assert lines[0].endswith("0/120 runs, 2 packings first; compiling, once for this kind of scene: packing, seed 1")
    assert "100.0 M grain-steps/s; about 64 s left; packing, seed 1: settling: 3e-4" in lines[1]
    assert max(map(len, lines)) <= 120


@pytest.mark.slow
def test_a_reader_that_goes_away_stops_nothing(tmp_path):
    lab, path = tmp_path / "lab", study_file(tmp_path, replicates=1)
    process = start("run", path, "--lab", lab, "--backend", "toy", delay=0.02)
    assert process.stderr is not None
    assert any("0/2 runs" in line for line in process.stderr), "after the warnings of the plan"
    process.stderr.close()
    assert process.stdout is not None
    out = process.stdout.read()
    assert process.wait(timeout=60) == 0, out
    assert "2 of 2 runs done" in out


@pytest.mark.slow
def test_run_without_a_terminal_says_that_it_compiles(tmp_path):
    path = study_file(tmp_path, replicates=1)
    shown = labbook("run", path, "--lab", tmp_path / "lab", "--backend", "toy", LABBOOK_TOY_COMPILES="0.3").stderr
    assert "compiling, once for this kind of scene: packing, seed 1" in shown
    assert not labbook("run", path, "--lab", tmp_path / "lab", "--backend", "toy").stderr, "nothing is waited for"


@pytest.mark.compiles
def test_the_cpu_backend_knows_when_it_compiles():
    from labbook_numba import compiling
    from numba.core import event

    backend = load("numba")
    compiling.watch.cache_clear()
    backend.open(backend.specialise(hopper(), Numerics(dt=1e-5)), 1).close()
    assert compiling.watch.cache_info().currsize == 1, "from the first opening on"
    assert not backend.compiling()
    with event.trigger_event("numba:compile"):
        assert backend.compiling()
    assert not backend.compiling()


@pytest.mark.slow
def test_what_takes_long_to_count_is_counted_seldom(tmp_path, monkeypatch):
    """Counting 10^5 runs takes a tenth of a second, in which the main thread saves and starts none."""
    counted = []

    def work_left(self):
        counted.append(time.perf_counter())
        time.sleep(0.05)
        return 1.0

    monkeypatch.setattr("labbook.run.job_queue.JobQueue.work_left", work_left)
    carry_out(study(tmp_path, orifices="[24]", replicates=1), tmp_path / "lab", backend=Backend(delay=0.02))
    assert np.diff(counted).min(initial=np.inf) > 0.9


@pytest.mark.parametrize("off", [0.1, 10.0])
def test_a_wrong_forecast_of_discharges_is_corrected_by_those_under_way(tmp_path, monkeypatch, off):
    monkeypatch.setattr(execution, "_STOP_INTERVAL", 0.0)  # after every beat, whatever the clock says
    monkeypatch.setattr(execution, "_REPORT_SHARE", math.inf)
    seen = []

    class Watch(NullWatcher):
        def show(self, view: View) -> None:
            seen.append((view.runs_done, view.fillings_left, view.work_done, view.work_left))

    foreseen = job_queue.discharge_work
    monkeypatch.setattr(job_queue, "discharge_work", lambda shared: off * foreseen(shared))
    # enough runs that some are still stepped when the first counts as done: it is written beside them
    carry_out(study(tmp_path, replicates=8), tmp_path / "lab", watcher=Watch(), workers=1)
    whole = seen[-1][2]
    ratios = [
        left / (whole - done) for runs, fillings, done, left in seen if runs >= 1 and not fillings and done < whole
    ]
    assert len(ratios) > 3
    middle = sorted(ratios)[len(ratios) // 2]
    assert 0.5 < middle < 2.0, ratios
