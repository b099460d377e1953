"""The round silos that ship for a laptop, with few grains and a short time, from their files to flow rates."""

import re
from pathlib import Path

import pytest

pytest.importorskip("numba")

from labbook_numba import Backend
from toy_results import analyse

from labbook.lab import Catalogue, LabFolder
from labbook.plan.coverage import finished
from labbook.run.runner import Runner
from labbook.study import load

pytestmark = [pytest.mark.compiles, pytest.mark.ring]

STUDIES = Path(__file__).parents[3] / "studies"
REDUCED = {
    "conical-silo": {
        r"count: 1500": "count: 150",
        r"diameter: 80 mm": "diameter: 40 mm",
        r'"\[20, 30, 45, 60\] deg"': '"[30, 60] deg"',
    },
    "pongo2022-small": {
        r"count: 1700": "count: 300",
        r"diameter: 60 mm": "diameter: 36 mm",
        r"fill_height: 30 mm": "fill_height: 4 mm",
        r'"\[0, .*\] Hz"': '"[0, 1.8] Hz"',
    },
}


@pytest.mark.parametrize("name", REDUCED)
def test_a_reduced_study_runs_to_its_flow_rates(name, tmp_path):
    text = (STUDIES / f"{name}.yaml").read_text(encoding="utf-8")
    text, *_ = text.partition("\nreference:")
    for old, new in {**REDUCED[name], r"replicates: [24]\b(?!})": "replicates: 1"}.items():
        text, changed = re.subn(old, new, text)
        assert changed == 1, old
    file = tmp_path / f"{name}.yaml"
    file.write_text(text, encoding="utf-8")
    asked = load(file)
    summary = Runner(asked, LabFolder(tmp_path / "lab"), Backend()).run()
    assert list(summary.tally.ran.values()) == ["finished"] * 2, summary.tally.failed
    found = analyse(asked, finished(Catalogue(tmp_path / "lab"), asked, "numba"))
    rates = [point.pooled["grain_rate"].value for point in found.points]
    assert len(rates) == 2
    for point, rate in zip(found.points, rates, strict=True):
        (run,) = point.runs
        assert rate > 100, "it flows"
        assert "ended within" not in run.measured["flow_rate"].note
        assert run.frames() is not None, "the first replicate is recorded"
        if "orifice" in asked.measure:
            assert -1 < run.measured["orifice_v_z"].value < 0, "grains above the orifice sink"
            assert run.measured["orifice_O_zz"].value + run.measured["orifice_O_rr"].value < 1
    assert rates[0] != rates[1], "angle and rotation reach the backend"
