"""A number has one evaluation: whoever asks for it later reads what is kept beside the run."""

import json
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from toy_lab import WINDOW, carry_out, labbook, study_file

from labbook.lab import Catalogue, LabFolder
from labbook.lab.evaluations import NotEvaluated, evaluate, evaluated
from labbook.lab.folder import EVALUATION
from labbook.lab.runs import open_run
from labbook.measure import MEASURES, Evaluation, MeasureError
from labbook.measure.packing import PackingStructure
from labbook.results.find import find
from labbook.results.find import stored_results as kept_results
from labbook.stats import Measured
from labbook.study import load
from labbook.study.schema import Window

MEASURED = ("flow_rate", "outlet_profiles", "packing")


def asked(folder: Path) -> Path:
    """A study file that asks for these measures."""
    path = study_file(folder, "fit: [beverloo]", count=400)
    path.write_text(path.read_text().replace("[flow_rate]", f"[{', '.join(MEASURED)}]"))
    return path


@pytest.fixture
def counted(monkeypatch):
    """How often each measure was evaluated, and packings were measured."""
    count = Counter()
    for name in MEASURED:
        kind = type(MEASURES[name])

        def evaluate(self, run, window, _evaluate=kind.evaluate):
            count[self.name] += 1
            return _evaluate(self, run, window)

        monkeypatch.setattr(kind, "evaluate", evaluate)

    def of(self, scene, packing, _of=PackingStructure.of):
        count["packings"] += 1
        return _of(self, scene, packing)

    monkeypatch.setattr(PackingStructure, "of", of)
    return count


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A folder with a study of two points with two replicates each, and its lab."""
    folder = tmp_path_factory.mktemp("done")
    carry_out(load(asked(folder)), folder / "lab")
    return folder


@pytest.fixture
def made(done, tmp_path):
    """A copy of that study, and of its lab."""
    shutil.copytree(done, tmp_path, dirs_exist_ok=True)
    return tmp_path / "toy.yaml", tmp_path / "lab"


def kept(lab: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in lab.glob(f"runs/*/{EVALUATION}*")}


def run_without_rows(folder: Path) -> Any:
    """The data of a run of the study, as far as faults of measures need it."""
    return SimpleNamespace(scene=load(asked(folder)).points[0].scene)


@pytest.mark.slow
def test_who_only_looks_evaluates_nothing(made, counted):
    path, lab = made
    study, catalogue = load(path), Catalogue(lab)
    found, looked = find(study, catalogue, "toy"), kept_results(study, catalogue, "toy")
    assert [one.pooled for one in looked.points] == [one.pooled for one in found.points]
    assert looked.unevaluated == ()
    assert looked.series[0].used == found.series[0].used == {0, 1}
    assert looked.points[0].runs[0].trace is not None
    later = study.change({"window.end": 0.5})
    looked = kept_results(later, catalogue, "toy")
    runs = [run for one in looked.points for run in one.runs]
    assert len(runs) == 4
    assert looked.unevaluated == tuple(run.run_key for run in runs)
    assert not any(run.measured for run in runs)
    with pytest.raises(NotEvaluated, match=runs[0].run_key):
        assert runs[0].trace
    assert not counted


def test_over_all_verbs_a_run_is_measured_once(tmp_path, counted, one_format):
    path = asked(tmp_path)
    there = ("--lab", tmp_path / "lab", "--backend", "toy")
    labbook("run", path, *there)
    once = {**dict.fromkeys(MEASURED, 4), "packings": 4}
    assert counted == once
    for verb in ("fit", "report", "export", "run", "report"):
        labbook(verb, path, *there)
    assert counted == once
    labbook("reindex", "--lab", tmp_path / "lab")
    labbook("report", path, *there)
    assert counted == once
    compared = ("compare", path, "--lab", tmp_path / "lab", "--backends", "toy,twin")
    labbook(*compared)
    first = dict(counted)  # the twin has made runs and packings of its own
    assert first["flow_rate"] == 8
    labbook(*compared)
    labbook("report", path, *there)
    assert counted == first


def test_another_window_or_version_is_measured_again_and_only_then(made, counted, monkeypatch):
    path, lab = made
    there = ("--lab", lab, "--backend", "toy")
    path.write_text(path.read_text().replace(WINDOW, "window: {start: 0.2, end: 0.5}"))
    for _ in range(2):
        labbook("fit", path, *there)
        assert counted["flow_rate"] == 4
    assert len(kept(lab)) == 2 * 3 * 4
    monkeypatch.setattr(type(MEASURES["flow_rate"]), "version", 99)
    for _ in range(2):
        labbook("fit", path, *there)
        assert (counted["flow_rate"], counted["packing"]) == (8, 4)
    listed = Catalogue(lab).measurements()
    own = listed[(listed["window_start"] == 0.2) & (listed["quantity"] == "flow_rate")]
    assert len({*own["run_key"]}) == len(own) == 4, "each number is listed once"
    assert set(own["version"]) == {99}


def test_what_is_kept_is_what_was_evaluated(made):
    path, lab = made
    study, found = load(path), {}
    for folder in sorted((lab / "runs").iterdir()):
        record, data = open_run(folder)
        for name in MEASURED:
            there = evaluated(folder, MEASURES[name], study.window, lambda: pytest.fail("it is kept"))
            now = MEASURES[name].evaluate(data, study.window)
            np.testing.assert_equal([vars(one) for one in there.evaluation.numbers], [vars(one) for one in now.numbers])
            np.testing.assert_equal(dict(there.evaluation.arrays), dict(now.arrays))
            found |= {(record.run_key, one.quantity): one for one in now.numbers}
    results = find(study, Catalogue(lab), "toy")
    shown = {
        (run.run_key, name): one for point in results.points for run in point.runs for name, one in run.measured.items()
    }
    np.testing.assert_equal(
        {key: vars(one) for key, one in shown.items()}, {key: vars(one) for key, one in found.items()}
    )


@pytest.mark.parametrize("damage", ["gone", "cut", "of another run", "no file"])
def test_a_lost_or_damaged_evaluation_is_made_again(made, counted, damage):
    path, lab = made
    before = json.loads(labbook("fit", path, "--lab", lab, "--backend", "toy", "--json").stdout)
    (lab / "catalogue.db").unlink()
    victims = [path for path in sorted(kept(lab)) if "flow_rate" in path.name]
    contents = [path.read_bytes() for path in victims]
    for place, victim in enumerate(victims):
        victim.unlink()
        if damage == "cut":
            victim.write_bytes(contents[place][: len(contents[place]) // 2])
        elif damage == "of another run":
            victim.write_bytes(contents[place - 1])
        elif damage == "no file":
            victim.mkdir()
    labbook("reindex", "--lab", lab)
    assert counted["flow_rate"] == 4
    assert json.loads(labbook("fit", path, "--lab", lab, "--backend", "toy", "--json").stdout) == before


def test_two_at_once_evaluate_once(made, counted):
    from concurrent.futures import ThreadPoolExecutor

    _, lab = made
    folder = next((lab / "runs").iterdir())
    window, (_, data) = Window(start=0.1, end=0.5), open_run(folder)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: evaluated(folder, MEASURES["flow_rate"], window, lambda: data), range(8)))
    assert counted["flow_rate"] == 1
    assert len({one.evaluation.numbers[0].value for one in found}) == 1
    assert not list((lab / "work").glob("*.look"))


def test_a_measure_that_fails_is_told_and_not_tried_again(made, monkeypatch):
    path, lab = made
    tried = []

    def evaluate(self, run, window):
        tried.append(run.seed)
        if run.seed == 2:
            raise MeasureError("the outlet was not seen")
        return Evaluation()

    monkeypatch.setattr(type(MEASURES["outlet_profiles"]), "evaluate", evaluate)
    monkeypatch.setattr(type(MEASURES["outlet_profiles"]), "version", 99)
    for _ in range(2):
        told = labbook("fit", path, "--lab", lab, "--backend", "toy").stderr
        assert told.count("outlet_profiles: the outlet was not seen") == 2
    assert sorted(tried) == [1, 1, 2, 2]
    results = find(load(path), Catalogue(lab), "toy")
    pooled = [one.pooled["flow_rate"].n for one in results.points]
    assert pooled == [2, 2], "other numbers of these runs stand"
    assert len(results.unmeasured) == 2
    assert not results.unreadable


def test_who_asks_the_wrong_backend_is_told_of_the_right_one(made):
    path, lab = made
    for verb in ("fit", "view"):
        told = labbook(verb, path, "--lab", lab, "--backend", "numba", check=False).stderr
        assert "finished run of toy-study on numba; it has runs on toy: add --backend toy" in told.replace("\n", " ")
    other = path.with_name("other.yaml")
    other.write_text(path.read_text().replace("toy-study", "other"))
    assert "there is no backend foo; installed are " in labbook(
        "fit", other, "--lab", lab, "--backend", "foo", check=False
    ).stderr.replace("\n", " ")
    told = labbook("fit", other, "--lab", lab, "--backend", "warp", check=False).stderr
    assert "--backend warp" in told


def test_a_lab_that_cannot_be_written_to_is_read_all_the_same(made, monkeypatch, counted):
    path, lab = made
    for one in kept(lab):
        one.unlink()
    other = replace(load(path), window=Window(start=0.2, end=0.5))

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("labbook.lab.evaluations.write_table", refuse)
    monkeypatch.setattr("labbook.lab.evaluations.add_measurements", lambda lab, rows: None)
    results = find(other, Catalogue(LabFolder(lab)), "toy")
    assert counted["flow_rate"] == 4
    assert all(point.flow_rate is not None for point in results.points)
    assert not kept(lab)


@pytest.mark.parametrize(
    ("give", "problem"),
    [
        (
            lambda: Evaluation((Measured("half_tiem", 1.0, 0.0, 1.0, "", "", "s"),)),
            "fails: it gives half_tiem, and does not declare it",
        ),
        (lambda: curt, "fails: NameError: name 'curt' is not defined"),  # noqa: F821  # pyright: ignore
        (lambda: None.nothing, "fails: AttributeError: 'NoneType' object has no attribute 'nothing'"),  # pyright: ignore
    ],
)
def test_a_fault_of_a_measure_is_told_and_ends_nothing(give, problem, monkeypatch, tmp_path):
    monkeypatch.setattr(type(MEASURES["flow_rate"]), "evaluate", lambda *_: give())
    result = evaluate(MEASURES["flow_rate"], Window(start=0.1, end=0.5), run_without_rows(tmp_path))
    assert (result.problem, result.evaluation.numbers) == (problem, ())


def test_a_measure_that_lacks_memory_is_tried_again(monkeypatch, tmp_path):
    def lacks(*_):
        raise MemoryError

    monkeypatch.setattr(type(MEASURES["flow_rate"]), "evaluate", lacks)
    with pytest.raises(MemoryError):
        evaluate(MEASURES["flow_rate"], Window(start=0.1, end=0.5), run_without_rows(tmp_path))
