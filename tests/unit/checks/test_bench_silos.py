"""Benchmarks on silos whose ring of bottom is narrow, and beside an experiment: what they work out from runs."""

import narrow_ring
import numpy as np
import plastic_spheres
import pytest

from labbook.scene.packing import Packing
from labbook.study import load


def test_the_mobile_share_counts_grains_on_the_ring_that_left():
    """Of six grains one lies over the outlet of 18 mm, one on others, and two of the four on the ring leave."""
    radius = np.array([0.0, 0.011, 0.012, 0.013, 0.014, 0.012])
    x = np.column_stack([radius, 0 * radius, [1.5e-3] * 5 + [4.2e-3]])
    packing = Packing(x=x, v=0 * x, omega=0 * x, ids=np.array([7, 3, 1, 4, 9, 2]))
    assert narrow_ring.mobile(packing, np.array([7, 3, 9, 2]), 0.018) == pytest.approx(0.5)
    assert np.isnan(narrow_ring.mobile(packing, np.array([7]), 0.031))


def test_beds_of_all_silos_are_equally_high():
    for width in narrow_ring.DIAMETERS:
        (point, *_) = narrow_ring.study(width, [18.0, 21.0], 2).points
        volume, area = point.scene.grains.count * point.scene.grains.volume, point.scene.container.area
        assert area is not None
        assert volume / area == pytest.approx(2000 * 4 / 6 * 3e-3**3 / 0.033**2, rel=1e-3)


def test_the_slope_of_the_measured_curve_and_its_error(monkeypatch):
    """Points at 20 % a second from 10 to 90 %, off the line by +1, -1, -1, +1 % within the window: the slope stays,
    and its error is sqrt(4e-4/2/0.05) /s by the textbook: residuals over n - 2, over the spread of times."""
    time = np.array([0.5, 1.0, 1.1, 1.2, 1.3, 4.5])
    part = 20 * time + np.array([0, 1, -1, -1, 1, 0])
    monkeypatch.setattr(plastic_spheres, "MEASURED", np.column_stack([time, part]))
    rate, error = plastic_spheres.slope(0.15, 0.8)
    assert rate == pytest.approx(0.2 * plastic_spheres.MASS)
    assert error == pytest.approx(np.sqrt(4e-4 / 2 / 0.05) * plastic_spheres.MASS)


def test_the_study_has_the_mass_of_the_experiment():
    study = load(plastic_spheres.STUDY)
    for point in study.points:
        grains = point.scene.grains
        assert grains.count * grains.mass == pytest.approx(plastic_spheres.MASS, abs=grains.mass)
    rate, error = plastic_spheres.slope(study.window.start, study.window.end)
    assert study.reference is not None
    (entry,) = study.reference.entries
    assert (entry.value, entry.error) == pytest.approx((rate, error), abs=1e-3)
