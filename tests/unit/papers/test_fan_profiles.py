"""Profiles along outlets in a report, from runs made with known profiles."""

import json
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from toy_results import analyse

from labbook.backend.numerics import Numerics
from labbook.lab.evaluations import evaluate
from labbook.measure.outlet import COVERAGE, CROSSINGS
from labbook.papers.fan2023 import figures, pages
from labbook.papers.fan2023.profiles import profile_fit, shared_parameters
from labbook.report.blocks import Folded
from labbook.report.page import write
from labbook.report.tables import Table
from labbook.results.frames import to_json
from labbook.results.paper import further_fits
from labbook.results.series import series_of
from labbook.results.starts import at_starts
from labbook.results.study import StudyResults
from labbook.study.schema import Reference, ReferenceEntry

A, B, GAMMA = 0.4, 0.3, 1.5
WIDTHS = (0.018, 0.024, 0.03, 0.042)


@dataclass(frozen=True)
class Profiled:
    """A finished run whose grains pass with speeds v_c (1 - u^2)^a, spread so that phi goes as (1 - u^2)^b."""

    run: Any
    numerics: Numerics

    def __getattr__(self, name):
        return getattr(self.run, name)

    def evaluated(self, measure, window):
        return evaluate(measure, window, self.data())

    def data(self):
        made = self.run.data()
        scene, crossing, rng = made.scene, made.tables["crossing"], np.random.default_rng(self.run.seed)
        R, r = scene.container.orifice / 2, scene.grains.radius
        n, beat = len(crossing["time"]), self.numerics.beat
        u = rng.uniform(-1, 1, 20 * n)
        u = u[(rng.uniform(0, 1, 20 * n) < (1 - u**2) ** (A + B)) & (abs(u) < 1 - r / R)][:n]
        speed = math.sqrt(2 * scene.gravity * GAMMA * R) * (1 - u**2) ** A
        number = np.floor((crossing["time"] - r / speed) / beat).astype(int)[:, None] + np.arange(60)
        z = speed[:, None] * (crossing["time"][:, None] - number * beat)
        grain, at = np.nonzero(abs(z) <= r)
        step = number[grain, at] * self.numerics.steps_per_beat
        slab = {"id": grain, "step": step, "time": step * self.numerics.dt}
        slab |= {"x": u[grain] * R, "z": z[grain, at], "vz": -speed[grain]}
        tables = {"crossing": {**crossing, "x": u * R, "vz": -speed}, "slab": slab}
        return replace(made, tables=tables, numerics=self.numerics)


@pytest.fixture(scope="module")
def profiled(synthetic) -> StudyResults:
    points = [synthetic.point(k, D) for k, D in enumerate(WIDTHS)]
    reference = Reference(
        "Fan et al. 2023",
        (
            ReferenceEntry("outlet_profiles.a", {}, A),
            ReferenceEntry("outlet_profiles.outlet_closure", {"container.orifice": 0.03}, 1.0),
        ),
    )
    study = synthetic.study_of(
        points,
        measure=("flow_rate", "outlet_profiles"),
        fit=("beverloo", COVERAGE, CROSSINGS),
        reference=reference,
    )
    numerics = Numerics(dt=1e-6, steps_per_beat=500)
    runs: Any = [Profiled(synthetic.FinishedDouble(p, seed), numerics) for p in points for seed in (1, 2, 3)]
    return analyse(study, runs)


def test_parameters_are_those_that_the_runs_were_made_from(profiled):
    (series,) = profiled.series
    found = series.further[COVERAGE].parameters
    assert found["a"].value == pytest.approx(A, abs=0.03)
    assert found["gamma"].value == pytest.approx(GAMMA, rel=0.03)
    assert found["b"].value == pytest.approx(B, abs=0.06)
    assert abs(found["delta1"].value) < 3 * found["delta1"].error
    assert set(series.fits) == {"beverloo"}


def test_the_grains_that_cross_give_the_same_exponents_where_speeds_do_not_scatter(profiled):
    """But for edges: fitted over whole outlets b is larger, since no centre comes within a radius of an edge, and a a
    little less, since of the last bin with grains only the inner, faster part has any.
    """
    (series,) = profiled.series
    found, covered = (series.further[name].parameters for name in (CROSSINGS, COVERAGE))
    assert A - 0.05 < found["a"].value < A
    assert found["gamma"].value == pytest.approx(GAMMA, rel=0.03)
    assert found["b"].value > covered["b"].value
    for one in series.further[CROSSINGS].outlets:
        assert one.direct.value == pytest.approx(1, abs=0.01)


def test_the_flow_of_the_profiles_closes(profiled):
    (series,) = profiled.series
    for result, one in zip(profile_fit(series, COVERAGE).points, profile_fit(series, COVERAGE).outlets, strict=True):
        assert result.pooled["outlet_closure"].value == pytest.approx(1, abs=0.01)
        assert one.direct.value == pytest.approx(result.pooled["outlet_closure"].value, rel=5e-3)
        assert one.centred.value == pytest.approx(1, abs=0.05)


def test_at_the_start_of_the_study_shapes_are_those_of_its_own_fit(profiled):
    """To the last bit, without bootstrap; and other starts have shapes of their own, all of the same motion."""
    (series,) = profiled.series
    starts = at_starts(profiled)
    for definition in (COVERAGE, CROSSINGS):
        expected = {name: one.value for name, one in series.further[definition].parameters.items()}
        (own,) = [at for at in starts if at.of_study]
        assert shared_parameters(definition, own.points) == expected
        gammas = [shared_parameters(definition, at.points)["gamma"] for at in starts]
        assert len(set(gammas)) > 4
        assert gammas == pytest.approx([GAMMA] * len(starts), rel=0.03)
    (section,) = pages.start_sections(profiled)
    folded = section.blocks[0]
    assert isinstance(folded, Folded)
    (table,) = folded.blocks
    assert isinstance(table, Table)
    assert [row[1] for row in table.rows] == [*(at.label for at in starts), "Fan et al. 2023"]
    assert table.rows[-1][2] == f"{A:.3f}"


def test_fitted_parameters_and_measured_numbers_are_both_compared(profiled):
    fitted, measured = profiled.comparisons
    assert fitted.quantity == "outlet_profiles.a"
    assert fitted.ours == profiled.series[0].further[COVERAGE].parameters["a"].value
    assert measured.quantity == "outlet_closure"
    assert measured.ours == pytest.approx(1, abs=0.01)


@pytest.mark.slow
@pytest.mark.usefixtures("one_format")
def test_tables_and_page_show_them(profiled, tmp_path):
    (series,) = profiled.series
    rows = {row[0]: row[1] for row in pages.profile_table(series, COVERAGE).rows}
    assert rows["a"].startswith(f"{series.further[COVERAGE].parameters['a'].value:.3f}")
    assert "±" in rows["δ₁"]  # a tilt of zero is a number, not one that is not determined
    assert [row[0] for row in pages.outlet_table(series, COVERAGE).rows] == ["18", "24", "30", "42"]
    page = write(profiled, tmp_path).read_text(encoding="utf-8")
    assert "Profiles along the outlets" in page
    for stem in ("profiles", "profiles-middles", "crossings", "crossings-middles"):
        assert (tmp_path / f"{stem}.svg").stat().st_size > 10_000
    found = json.loads(to_json(profiled))
    (a,) = (row for row in found["fits"] if (row["law"], row["parameter"]) == (COVERAGE, "a"))
    assert a["value"] == pytest.approx(series.further[COVERAGE].parameters["a"].value, rel=1e-14)
    assert len([row for row in found["outlets"] if row["definition"] == COVERAGE]) == 4


def test_the_reference_stands_beside_ours_where_the_law_is_shown(profiled):
    (series,) = profiled.series
    table = pages.profile_table(series, COVERAGE, profiled.comparisons, profiled.source)
    assert table.headings[3:] == ("Fan et al. 2023", "inside interval")
    cells = {row[0]: row[3:] for row in table.rows}
    ours = series.further[COVERAGE].parameters["a"]
    assert cells["a"][0] == "0.4"
    assert cells["a"][1] == ("yes" if ours.low <= 0.4 <= ours.high else "no")
    assert cells["b"] == ("–", "–")
    assert len(pages.profile_table(series, CROSSINGS, profiled.comparisons, profiled.source).headings) == 3


def test_points_that_lack_runs_are_fitted_and_named(profiled):
    """One of three runs is missing at 24 mm: every fit that takes the point in says so, and no other does."""
    (series,) = profiled.series
    assert not any(
        "missing runs" in note for fit in (*series.fits.values(), *series.further.values()) for note in fit.notes
    )
    points = [replace(r, runs=r.runs[:2]) if r.orifice == 0.024 else r for r in series.points]
    (again,) = series_of(points, ("beverloo", COVERAGE), further_fits())
    for fit in (again.fits["beverloo"], again.further[COVERAGE]):
        (said,) = [note for note in fit.notes if "missing runs" in note]
        assert "24 mm with 2 of 3 runs;" in said


def test_the_figures_have_bands_of_the_law_and_of_one_more_point(profiled):
    (series,) = profiled.series
    _, middle, _ = figures.outlet_middles(series, COVERAGE).axes
    R = 0.015
    curve = series.further[COVERAGE].curves["phi_c"]
    spans = []
    for shaded in middle.collections[-2:]:
        x, y = np.asarray(shaded.get_paths()[0].vertices).T
        at = y[np.isclose(x, x[np.argmin(abs(x - R * 1e3))])]
        spans.append(np.ptp(at))
    expected = [2 * np.interp(R, curve.at, half) for half in (curve.point, curve.law)]
    assert sorted(spans) == pytest.approx(sorted(expected), rel=0.1)
    assert spans[0] > spans[1]


def test_the_figure_lays_profiles_over_each_other(profiled):
    (series,) = profiled.series
    figure = figures.outlet_profiles(series, COVERAGE)
    below = figure.axes[2]
    collapsed = [line for line in below.lines if line.get_marker() not in ("None", None, "")]
    assert len(collapsed) == 4
    x = np.linspace(-0.7, 0.7, 9)
    over = [np.interp(x, *np.asarray(line.get_data(), float)) for line in collapsed]
    assert np.ptp(over, axis=0).max() < 0.08


def test_without_profiles_the_series_says_why(synthetic):
    points = [synthetic.point(0, 0.03)]
    study = synthetic.study_of(points, fit=("outlet_profiles",), reference=None)
    runs = [synthetic.FinishedDouble(points[0], seed) for seed in (1, 2)]
    (series,) = analyse(study, runs).series
    assert not series.further
    assert "measure outlet_profiles" in series.problems[0]
