"""The calibration in pieces: benchmarks/calibration.py."""

import argparse
import csv
import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest

import labbook

ROOT = Path(__file__).parents[3]
RUNS = ROOT / "benchmarks" / "results" / "2026-11-27-calibration"


@pytest.fixture(scope="module")
def calibration():
    spec = importlib.util.spec_from_file_location("calibration_pieces", ROOT / "benchmarks" / "calibration.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_entries_of_paired_runs_are_the_mean_of_the_pairs(calibration, tmp_path, capsys):
    """Two steps from each bed: the slope is the mean change of ln W over that of the squared step, its error the
    scatter between pairs."""
    for path in RUNS.glob("accuracy-outlets-*.csv"):
        (tmp_path / path.name).write_text(path.read_text())
    calibration.entries(argparse.Namespace(folder=tmp_path, out=tmp_path / "all.json"))
    found = json.loads((tmp_path / "all.json").read_text())["effects"]
    assert [round(one["scene"]["ratio"], 3) for one in found] == [6, 7.5, 18]
    for number, one in enumerate(found, 1):
        beds: dict[str, dict[int, float]] = {}
        with (tmp_path / f"accuracy-outlets-{number}.csv").open() as file:
            for row in csv.DictReader(file):
                if row["W_g_per_s"]:
                    beds.setdefault(row["seed"], {})[int(row["setting"])] = math.log(float(row["W_g_per_s"]))
        change = np.array([pair[1] - pair[0] for pair in beds.values() if len(pair) == 2]) / (0.06**2 - 0.02**2)
        assert one["slopes"][1] == pytest.approx(change.mean(), rel=1e-3)
        error = change.std(ddof=1) / math.sqrt(len(change))
        assert math.sqrt(one["covariance"][1][1]) == pytest.approx(error, rel=1e-3)
        assert one["scene"]["version"] == 2
    assert "accuracy-outlets-3" in capsys.readouterr().out


def test_scenes_have_all_settings_of_one_point(calibration):
    study = labbook.load(ROOT / "studies" / "accuracy-hopper.yaml")
    found = calibration.scenes(study)
    assert [len(points) for points in found] == [6] * 11
    assert len({point.scene.model_dump_json() for point in found[0]}) == 1


def test_a_scene_is_written_once_it_is_whole_and_not_made_again(calibration, tmp_path, monkeypatch):
    study = labbook.load(ROOT / "studies" / "accuracy-outlets.yaml")
    asked = []

    class Lab:
        stopped = False

        def __init__(self, *_):
            pass

        def run(self, part, progress):
            asked.append(part.points[0].at["container.orifice"])
            return self if len(asked) < 2 else replace_stopped(self)

        def results(self, part, progress):
            return argparse.Namespace(points=())

    def replace_stopped(lab):
        lab.stopped = True
        return lab

    monkeypatch.setattr(calibration.labbook, "Lab", Lab)
    args = argparse.Namespace(
        names=[study.name], lab=tmp_path / "lab", backend="toy", device="cpu", out=tmp_path, scenes=None
    )
    calibration.run(args)
    assert asked == [0.018, 0.0225]
    assert [path.name for path in tmp_path.glob("*.csv")] == ["accuracy-outlets-1.csv"]
    calibration.run(args)
    assert asked == [0.018, 0.0225, 0.0225]
    args.scenes = [3]
    calibration.run(args)
    assert asked[3:] == [0.054], "those that are asked for"
