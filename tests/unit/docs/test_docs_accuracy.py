"""The figures of docs/accuracy.md show the numbers of its tables."""

import math
import re
from pathlib import Path

import accuracy
import pytest

ROOT = Path(__file__).parents[3]
RUNS = ROOT / "benchmarks" / "results" / "2026-11-27-calibration"
ROW = r"^\| `hertz-mindlin` \| {} \|.*\| ([−+][\d.]+) ± ([\d.]+) % \| [\d.]+ % \|$"


@pytest.mark.parametrize(("ratio", "study", "number"), [("6", "accuracy-outlets", 1)])
def test_the_effect_of_the_step_is_that_of_the_table(ratio, study, number):
    row = re.search(ROW.format(ratio), (ROOT / "docs" / "accuracy.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert row is not None
    change = accuracy.scene(RUNS, study, number).change(1)
    assert change.percent == pytest.approx(float(row[1].replace("−", "-")), abs=0.006)
    assert change.half_width / 1.96 == pytest.approx(float(row[2]), rel=0.04)


def test_changes_are_taken_bed_by_bed():
    """Two beds that differ by 10 % and both lose 1 %: no error is left."""
    rates = {0: {"a": 0.0, "b": 0.1}, 1: {"a": math.log(0.99), "b": 0.1 + math.log(0.99)}}
    change = accuracy.Scene((), rates).change(1)
    assert (change.percent, change.half_width) == pytest.approx((-1.0, 0.0))
