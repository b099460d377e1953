"""The benchmark of the web app runs, on a small lab."""

import importlib.util
from pathlib import Path

import pytest

from labbook.lab import Catalogue


@pytest.mark.slow
def test_the_benchmark_asks_for_every_page_of_a_made_up_lab(tmp_path):
    path = Path(__file__).parents[2] / "benchmarks/web.py"
    spec = importlib.util.spec_from_file_location("benchmark_of_the_web_app", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found = module.pages(tmp_path / "lab", wanted=250, repeats=1, side=5)
    assert [one["page"] for one in found] == list(module.PAGES)
    assert all(one["first"] > 0 and one["kilobytes"] > 0 for one in found)
    catalogue = Catalogue(module.LabFolder(tmp_path / "lab"))
    assert len(catalogue.runs()) == 250  # two studies of 5 x 5 points with five runs each
    catalogue.close()
