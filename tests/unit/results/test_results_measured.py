"""Measurements beside results: points that are not simulated, and the measurement's own fit."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from toy_results import analyse

from labbook.report.figures import flow_against_orifice
from labbook.report.fitted_tables import fit_table
from labbook.results.reference import at_series, measured_fit
from labbook.study.schema import Reference, ReferenceEntry

# three of these orifices are simulated, two are not
ORIFICES = (0.018, 0.02, 0.03, 0.04, 0.06)
C, K = 0.7, 1.2


def measured(synthetic, errors: bool = True) -> Reference:
    entries = []
    for D in ORIFICES:
        W = synthetic.beverloo(synthetic.scene(D), C, K)
        at: dict[str, float | str] = {"container.orifice": D}
        entries.append(ReferenceEntry("flow_rate", at, W, 0.02 * W if errors else None, measured=True))
    return Reference("bench.csv", tuple(entries))


@pytest.fixture(scope="module")
def beside(column, synthetic):
    study, finished = column
    return analyse(replace(study, reference=measured(synthetic)), finished)


def test_the_measurement_has_a_fit_of_its_own(beside, synthetic):
    """Exact values of Beverloo's law: its C and k come back; errors of 2 % decide how well they are known."""
    (series,) = beside.series
    known = at_series(beside.comparisons, "beverloo", series)
    assert known["C_particle"].reference == pytest.approx(C, rel=1e-6)
    assert known["k"].reference == pytest.approx(K, rel=1e-6)
    # linearised least squares of ln W: d ln W = d ln C - 1.5 dk / (D/d - k), each with an error of 0.02
    design = np.array([(1.0, -1.5 / (D / 0.003 - K)) for D in ORIFICES])
    covariance = np.linalg.inv(design.T @ design) * 0.02**2
    assert known["k"].reference_error == pytest.approx(np.sqrt(covariance[1, 1]), rel=1e-3)
    assert known["C_particle"].reference_error == pytest.approx(C * np.sqrt(covariance[0, 0]), rel=1e-3)
    ours = series.fits["beverloo"].parameters["k"]
    assert known["k"].ours == ours.value
    table = fit_table("beverloo", series.fits["beverloo"], known, beside.source)
    assert "bench.csv" in table.headings
    assert not any("together" in note for note in table.notes), "their errors belong together"
    assert any(row[0] == "k" and row[3].startswith("1.20 ±") for row in table.rows)


def test_measured_points_need_not_be_simulated(beside):
    rates = [one for one in beside.comparisons if one.quantity == "flow_rate"]
    assert [one.ours is None for one in rates] == [False, True, False, True, False]
    assert all(one.why for one in rates if one.ours is None)
    assert rates[2].relative == pytest.approx(rates[2].ours / rates[2].reference - 1)


def test_they_are_drawn_with_their_errors_and_residuals(beside):
    (series,) = beside.series
    figure = flow_against_orifice(series, beside.comparisons, beside.source)
    main, below = figure.axes
    diamonds = [line for line in main.lines if line.get_marker() == "D"]
    assert len(diamonds) == 1
    assert diamonds[0].get_xdata() == pytest.approx([1e3 * D for D in ORIFICES])
    rates = [one for one in beside.comparisons if one.quantity == "flow_rate"]
    bars = [one.get_segments() for one in main.collections if isinstance(one, LineCollection)]
    (segments,) = [each for each in bars if len(each) == len(ORIFICES)]
    for segment, entry in zip(segments, rates, strict=True):
        W, half = 1e3 * entry.reference, 1.96 * 0.02 * 1e3 * entry.reference
        assert segment[:, 1] == pytest.approx([(W - half) ** (2 / 3), (W + half) ** (2 / 3)])
    (residuals,) = [line for line in below.lines if line.get_marker() == "D"]
    expected, _, _ = series.fits["beverloo"].band(np.array(ORIFICES))
    W = np.array([c.reference for c in beside.comparisons[:5]])
    assert residuals.get_ydata() == pytest.approx(100 * (W / expected - 1))


def test_without_errors_they_are_taken_from_the_scatter(column, synthetic):
    study, finished = column
    reference = measured(synthetic, errors=False)
    entries = [replace(e, value=e.value * (1 + 0.01 * (-1) ** k)) for k, e in enumerate(reference.entries)]
    found = analyse(replace(study, reference=Reference("x", tuple(entries))), finished)
    fitted = measured_fit(Reference("x", tuple(entries)), "beverloo", found.series[0])
    assert fitted is not None
    assert np.sqrt(np.sum(fitted.residuals**2) / 3) == pytest.approx(np.mean(fitted.relative_error), rel=1e-6)
    assert measured_fit(Reference("x", tuple(entries[:2])), "beverloo", found.series[0]) is None
