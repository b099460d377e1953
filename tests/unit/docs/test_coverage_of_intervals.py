"""The table of coverage in docs/accuracy.md is that of benchmarks/intervals.py, and its intervals cover."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[3]
RESULT = ROOT / "benchmarks/results/2026-11-27-coverage.json"


@pytest.fixture(scope="module")
def coverage():
    spec = importlib.util.spec_from_file_location("coverage_of_intervals", ROOT / "benchmarks/intervals.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def cases(coverage):
    return [coverage.Case(**row) for row in json.loads(RESULT.read_text(encoding="utf-8"))["cases"]]


def test_the_page_has_the_table_of_the_simulation(coverage, cases):
    assert coverage.table(cases) in (ROOT / "docs/accuracy.md").read_text(encoding="utf-8")


def test_no_interval_covers_much_less_than_it_states(cases):
    """By more than 4 %, beyond three standard errors of the simulation. Other first looks are not those of labbook."""
    used = [one for one in cases if "first look" not in one.interval]
    assert len({one.interval for one in used}) > 20
    assert [one for one in used if one.coverage + 3 * one.error < one.nominal - 0.04] == []


def test_the_simulation_runs(coverage):
    found = list(coverage.means(np.random.default_rng(1), 0.02))
    assert {one.interval for one in found} == {"mean, Student", "mean of nested beds"}
    assert all(0.7 < one.coverage <= 1 for one in found)
    assert coverage.table(found).count("\n") == 3
