"""Fitted laws against the start of the window: the same as if the study stated that start, from one evaluation."""

from dataclasses import replace

import pytest
from toy_lab import labbook, study_file
from toy_results import analyse

from labbook.measure.starts import STARTS, WindowStarts
from labbook.report.starts import start_table
from labbook.results.budget import budgets
from labbook.results.frames import frames
from labbook.results.starts import at_starts, parameters_at
from labbook.study import Window

pytestmark = pytest.mark.slow


def with_start(study, start):
    return replace(study, window=Window(start=start, end=study.window.end))


@pytest.fixture(scope="module")
def column(synthetic):
    """One series of four orifices with two seeds each."""
    points = [synthetic.point(k, D) for k, D in enumerate((0.018, 0.03, 0.045, 0.06))]
    study = synthetic.study_of(points, measure=("flow_rate", "packing"), fit=("beverloo",))
    return study, [synthetic.FinishedDouble(point, seed) for point in points for seed in (1, 2)]


@pytest.fixture(scope="module")
def stated(column):
    """C and k of the column where the study states a start, by that start."""
    study, runs = column
    found = {}
    for start in (*STARTS, "auto"):
        results = analyse(with_start(study, start), runs)
        found[start] = {name: one.value for name, one in results.series[0].parameters("beverloo").items()}
    return found


def test_parameters_are_those_of_a_study_that_states_the_start(column, stated):
    """To the last bit, also C by the bulk density, which needs the packing fraction; and for the study's own start."""
    study, runs = column
    results = analyse(study, runs)
    for name in stated[0.15]:
        moved = parameters_at(at_starts(results), results.series[0], "beverloo", name)
        starts = ["auto" if at.window.auto else at.window.start for at, _ in moved]
        assert starts == [*STARTS, "auto"]
        assert [one.value for _, one in moved] == [stated[start][name] for start in starts]
        (own,) = [one for at, one in moved if at.of_study]
        assert own.value == results.series[0].parameters("beverloo")[name].value


def test_a_start_of_its_own_is_among_them(column):
    study, runs = column
    starts = at_starts(analyse(with_start(study, 0.12), runs))
    assert [at.window.start for at in starts if not at.window.auto] == sorted((*STARTS, 0.12))
    assert [at.window.start for at in starts if at.of_study] == [0.12]
    (auto,) = [at for at in at_starts(analyse(with_start(study, "auto"), runs)) if at.of_study]
    assert auto.window.auto


def test_the_budget_has_the_largest_change_between_sensible_starts(column, stated):
    study, runs = column
    found = {one.quantity: one for one in budgets(analyse(study, runs))}
    for name in ("C_particle", "k"):
        (share,) = [share for share in found[f"beverloo.{name}"].shares if share.source == "window"]
        others = [stated[start][name] for start in (0.1, 0.2, "auto")]
        assert share.relative == pytest.approx(max(abs(one / stated[0.15][name] - 1) for one in others), rel=1e-12)
        assert share.basis == "largest difference to starts of 10 %, 20 %, auto"
        early = max(abs(stated[start][name] / stated[0.15][name] - 1) for start in (0.0, 0.02, 0.05))
        assert share.relative != pytest.approx(early)


def test_tables_and_frames_have_a_row_for_each_start(column):
    study, runs = column
    results = analyse(study, runs)
    table = start_table(results, at_starts(results), "beverloo", results.series)
    assert [row[0] for row in table.rows[:5]] == ["0", "0.02", "0.05", "0.1", "0.15 (stated)"]
    assert table.rows[-1][0] == "Fan et al. 2023"
    rows = frames(results, ["starts"])["starts"].query("law == 'beverloo' and parameter == 'k'")
    assert rows["start"].tolist() == ["0", "0.02", "0.05", "0.1", "0.15", "0.2", "auto"]


@pytest.mark.parametrize("change", [{"fit": ()}, {"window": Window(after=0.1, until=0.2)}])
def test_nothing_is_evaluated_where_nothing_is_fitted_or_the_window_is_one_in_time(column, change, monkeypatch):
    study, runs = column
    monkeypatch.setattr(WindowStarts, "evaluate", lambda *_: pytest.fail("evaluated"))
    assert at_starts(analyse(replace(study, **change), runs)) == ()


def test_starts_are_evaluated_once_and_kept_beside_the_run(tmp_path, monkeypatch):
    path = study_file(tmp_path, "fit: [power]", orifices="[18, 21, 24]", count=400)
    labbook("run", path, "--lab", tmp_path / "lab", "--backend", "toy")
    runs = list((tmp_path / "lab" / "runs").iterdir())
    labbook("fit", path, "--lab", tmp_path / "lab", "--backend", "toy")
    assert not any(list(run.glob("measured-window_starts-*.npz")) for run in runs)  # what fits print needs none
    labbook("export", path, "--lab", tmp_path / "lab", "--backend", "toy", "--out", tmp_path / "first")
    assert all(len(list(run.glob("measured-window_starts-*.npz"))) == 1 for run in runs)
    monkeypatch.setattr(WindowStarts, "evaluate", lambda *_: pytest.fail("evaluated again"))
    told = labbook("export", path, "--lab", tmp_path / "lab", "--backend", "toy", "--out", tmp_path / "tables").output
    assert "evaluated again" not in told
    assert (tmp_path / "tables" / "starts.csv").exists()
