"""Residence times in reports and frames: a batch and a fed bed of the toy backend, whose lowest grain leaves first."""

import numpy as np
import pytest
from toy_lab import carry_out, study

from labbook.api import Lab
from labbook.measure.regime import FlowRegime

MEASURE = {"measure": ["flow_rate", "residence"]}
pytestmark = pytest.mark.slow


def results_of(asked, lab):
    carry_out(asked, lab)
    return Lab(lab, backend="toy").results(asked, progress=False)


def test_a_batch_has_map_and_layers(tmp_path):
    asked = study(tmp_path, orifices="[24]", count=400, replicates=1)
    results = results_of(asked.change(MEASURE), tmp_path / "lab")
    frames = results.frames()
    z, median, grains = (frames["residence"][name].to_numpy() for name in ("z_from", "median", "grains"))
    assert grains.sum() == pytest.approx(400)
    assert np.corrcoef(z[np.isfinite(median)], median[np.isfinite(median)])[0, 1] > 0.9, "the lowest grains leave first"
    kind, share = (frames["layers"][name].to_numpy() for name in ("kind", "share"))
    assert list(dict.fromkeys(kind)) == [f"layer {k}" for k in range(1, 6)]
    assert share[kind == "layer 1"][0] > share[kind == "layer 5"][0]
    assert frames["residence"].attrs["units"]["median"] == "s"
    assert "residence_map" in results.figures()


def test_a_fed_bed_has_a_distribution(tmp_path, one_format):
    changes = {"orifices": "[24]", "count": 60, "replicates": 1}
    asked = study(tmp_path, "feed: {kind: reinject}", "stop: {max_time: 0.8 s}", **changes)
    results = results_of(asked.change({"numerics.steps_per_beat": 2000, **MEASURE}), tmp_path / "lab")
    frame = results.frames()["residence_times"]
    age, part, density = (frame[name].to_numpy() for name in ("age", "part", "exit_age"))
    assert part[0] == 0
    assert 0.9 < part[-1] <= 1
    assert (np.diff(part) >= 0).all()
    assert density[:-1] @ np.diff(age) == pytest.approx(part[-1])
    page = results.report(tmp_path / "report").read_text(encoding="utf-8")
    assert "N/Q" in page
    assert "residence" in results.figures()


def test_names_of_the_regime_are_declared():
    assert {one.name for one in FlowRegime().declared} == {"regime.mass_flow_index", "regime.still"}
