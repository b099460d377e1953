"""The names of `import labbook`: found late, documented, and true on the toy backend."""

import inspect
import os
import re
import subprocess
import sys
import warnings
from dataclasses import replace
from datetime import date
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import study, study_file

import labbook
from labbook.export.film import film, is_film_of, source_of_film
from labbook.export.frames import NotRecorded
from labbook.lab import Catalogue, RunRecord
from labbook.lab.folder import remove
from labbook.plan.plan import Planner
from labbook.report.setting import setting
from labbook.run.job_queue import Tally
from labbook.run.notebook import NotebookBar
from labbook.run.runner import Runner
from labbook.run.watch import ActiveJob, View

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs/python.md").read_text(encoding="utf-8")
HEAVY = {"numba", "warp", "rerun", "sqlalchemy", "matplotlib", "pandas", "scipy", "pint", "labbook_numba", "numpy"}
FITTED = ("fit: [beverloo]", "record: {every: 20 ms}")
SIZES = {"orifices": "[18, 21, 24, 30]", "replicates": 3}


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A lab with a study carried out on the toy backend, and its results."""
    folder = tmp_path_factory.mktemp("api")
    lab = labbook.Lab(folder / "lab", "toy")
    asked = study(folder, *FITTED, **SIZES)
    assert lab.run(asked, progress=False).complete
    return lab.results(asked, progress=False)


def lab_of(found: labbook.Results) -> labbook.Lab:
    return labbook.Lab(found.lab_folder.folder, found.backend)


def loaded_by(code: str) -> set[str]:
    """Modules that a process has loaded after `code`."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "backends")])}
    command = [sys.executable, "-c", f"{code}; import sys; print(*sys.modules)"]
    return set(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split())


def test_import_loads_nothing_that_is_heavy():
    assert not loaded_by("import labbook; dir(labbook)") & HEAVY


def test_a_study_needs_neither_a_database_nor_pictures():
    code = f"import labbook; labbook.load({str(ROOT / 'studies/quickstart.yaml')!r})"
    assert not loaded_by(code) & {"numba", "warp", "rerun", "sqlalchemy", "matplotlib", "pandas", "labbook_numba"}


def test_all_names_are_there_and_an_unknown_one_is_told():
    assert set(labbook.__all__) <= set(dir(labbook))
    for name in labbook.__all__:
        assert getattr(labbook, name) is getattr(labbook, name)
    with pytest.raises(AttributeError, match="Labb"):
        getattr(labbook, "Labb")  # noqa: B009  (pyright knows that it is not there)


def public(thing: type) -> list[str]:
    """Methods and properties of a class."""
    kinds = (property, staticmethod, classmethod, cached_property)
    return [
        name
        for name, found in vars(thing).items()
        if not name.startswith("_") and (inspect.isfunction(found) or isinstance(found, kinds))
    ]


NAMED = {"Study", "Lab", "Results", "Run", "FitResult", "Summary"}
"""Classes made for Python, of which the page says everything; others have more than is public."""
INNER = {"Study": {"numerics"}, "Lab": {"lab_folder"}, "FitResult": {"chi2_reduced"}}


@pytest.mark.parametrize("name", [name for name in labbook.__all__ if name != "__version__"])
def test_every_public_name_is_documented(name):
    thing = getattr(labbook, name)
    assert inspect.getdoc(thing)
    assert re.search(rf"`(labbook\.)?{name}[`(]", PAGE), f"docs/python.md does not speak of {name}"
    if not inspect.isclass(thing) or issubclass(thing, Exception):
        return
    for method in public(thing):
        assert inspect.getdoc(vars(thing)[method]), f"{name}.{method} has no docstring"
        if name in NAMED and method not in INNER.get(name, ()):
            assert re.search(rf"\.{method}\b", PAGE), f"docs/python.md does not speak of {name}.{method}"


def test_what_the_page_names_is_there(found):
    """Names in the tables of the page: `lab.plan(study)`, and `.q` after the first of a row."""
    objects = {
        "study": found.study,
        "point": found.study.points[0],
        "scene": found.study.points[0].scene,
        "lab": lab_of(found),
        "plan": lab_of(found).plan(found.study),
        "summary": lab_of(found).run(found.study, progress=False),
        "results": found,
        "fit": found.fit("beverloo"),
        "run": found.run(1),
        "trajectories": found.run(1).trajectories(),
    }
    seen = 0
    for row in (line for line in PAGE.splitlines() if line.startswith("| `")):
        cell = row.split("|")[1]
        head = re.match(r" `(\w+)\.\w+", cell)
        which = head[1] if head else "trajectories" if re.match(r" `\.\w+", cell) else None
        if which in objects:
            for name in re.findall(r"\.(\w+)", re.sub(r"\([^`]*\)", "", cell)):
                assert hasattr(objects[which], name), f"{which}.{name}"
                seen += 1
    assert seen > 50


@pytest.mark.slow
def test_the_example_of_the_page_holds(tmp_path, monkeypatch, capsys):
    code = PAGE.split("```python\n")[1].split("```")[0]
    assert len(code.strip().splitlines()) <= 28
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(code.replace('labbook.Lab("lab")', 'labbook.Lab("lab", "toy")'), names)
    assert "16 missing" in capsys.readouterr().out
    assert len(names["results"].runs) == 16
    assert (names["low"] < names["W"]).all()
    assert (tmp_path / "flow.pdf").exists()


def test_a_plan_tells_what_is_missing_and_what_it_costs(tmp_path):
    asked, lab = study(tmp_path, **SIZES), labbook.Lab(tmp_path / "lab", "toy")
    plan = lab.plan(asked)
    frame = plan.frame()
    assert len(frame) == 12
    assert set(frame["state"]) == {"missing"}
    assert frame.attrs["units"] == {"container.orifice": "m"}
    assert plan.forecast is not None
    assert plan.forecast.seconds > 0
    assert plan.lines()[0] == "12 missing"
    assert "3 packings to make; about" in repr(plan)
    assert plan._repr_html_().count("<td>3</td>") == 4
    lab.run(asked, progress=False)
    again = lab.plan(asked)
    assert set(again.frame()["state"]) == {"done"}
    assert again.forecast is not None
    assert again.forecast.seconds == 0


def test_warnings_of_a_plan_have_key_and_remedy(tmp_path):
    plan = labbook.Lab(tmp_path / "lab", "toy").plan(study(tmp_path, orifices="[6, 24]"))
    assert any("container.orifice" in line and "remedy" in line for line in plan.warnings)
    assert "container.orifice" in repr(plan)


def test_a_row_of_the_frame_is_a_point_with_units(found):
    frame = found.frame()
    assert list(frame["container.orifice"]) == [0.018, 0.021, 0.024, 0.030]
    assert frame.attrs["units"]["flow_rate_low"] == "kg/s"
    for row, result in zip(frame.itertuples(), found.points, strict=True):
        pooled = result.flow_rate
        assert (row.flow_rate, row.flow_rate_error) == (pooled.value, pooled.error)
        assert row.flow_rate_low < row.flow_rate < row.flow_rate_high
    assert (frame[["flow_rate"]] * 2).attrs["units"] == frame.attrs["units"]


def test_frames_are_those_of_the_export(found, tmp_path):
    frames = found.frames()
    paths = found.export(tmp_path / "out")
    assert {path.stem for path in paths} == set(frames)
    for path in paths:
        assert path.read_text() == frames[path.stem].to_csv(index=False)
        assert set(frames[path.stem].attrs["units"]) <= set(frames[path.stem])
    assert frames["flow"].attrs["units"]["time"] == "s"


def test_every_packing_is_exported_once_and_the_walls_of_every_point(found, tmp_path):
    paths = found.export(tmp_path / "out", packings=True)
    written = [path for path in paths if path.parent.name == "packings"]
    assert all(path.exists() for path in written)
    assert len([path for path in written if path.suffix == ".data"]) == len({run.packing_key for run in found.runs})
    for number, point in enumerate(found.study.points, 1):
        walls = {path.stem.removeprefix(f"point-{number}-") for path in written if path.match(f"point-{number}-*.stl")}
        assert walls == {wall.name for wall in point.scene.container.walls()}


def test_a_fit_is_that_of_the_study_or_made_now(found):
    assert found.fit("beverloo") is found.series[0].fits["beverloo"]
    assert "janda" not in found.series[0].fits
    janda = found.fit("janda")
    assert janda.law.name == "janda"
    W, low, high = found.fit("beverloo").predict([0.02, 0.025])
    assert (low < W).all()
    assert (high > W).all()
    k = found.fit("beverloo").parameters["k"]
    row = found.fit("beverloo").frame().set_index("parameter").loc["k"]
    assert (row["value"], row["low"], row["high"]) == (k.value, k.low, k.high)
    assert f"k = {k.value:.4g}" in repr(found.fit("beverloo"))
    with pytest.raises(labbook.FitError, match="did you mean beverloo"):
        found.fit("bevrloo")
    with pytest.raises(labbook.FitError, match="hole"):
        found.fit("beverloo_3d")


@pytest.mark.slow
def test_a_series_is_named_by_its_values_with_units(tmp_path):
    file = study_file(tmp_path, "fit: [beverloo]", **SIZES)
    asked = labbook.load(file).change({"sweep.container.angle": "[45, 90] deg"})
    lab = labbook.Lab(tmp_path / "lab", "toy")
    lab.run(asked, progress=False)
    results = lab.results(asked, progress=False)
    flat = results.fit("beverloo", {"container.angle": "90 deg"})
    assert flat is results.fit("beverloo", {"container.angle": np.pi / 2})
    assert flat is not results.fit("beverloo", {"container.angle": "45 deg"})
    assert results.figures()[0] == "overview"
    assert len(results.plot().axes) >= 1
    assert results.figures({"container.angle": "45 deg"})[0] == "flow_rate"
    with pytest.raises(LookupError, match=r"{'container.angle': '45 deg'}"):
        results.fit("beverloo")
    with pytest.raises(LookupError, match="0 series"):
        results.plot("flow_rate", {"container.angle": "60 deg"})


def test_figures_are_those_of_the_report_and_show_themselves(found):
    assert {"flow_rate", "flow_over_time"} <= set(found.figures())
    figure = found.plot("flow_rate")
    assert len(figure.axes) == 2
    data, size = figure._repr_png_()
    assert data.startswith(b"\x89PNG")
    assert size["width"] > 200
    with pytest.raises(LookupError, match="flow_over_time"):
        found.plot("flow_over_tim")


def test_trajectories_are_the_recorded_rows_by_grain(found):
    run = found.run(2, seed=1)
    paths = run.trajectories()
    rows = run.run.data().frames()
    assert paths.x.shape == paths.v.shape == (len(paths.time), 200, 3)
    assert np.isfinite(paths.x[:, :, 2]).sum() == len(rows["time"])
    for k in (0, len(rows["id"]) // 2, -1):
        frame = int(np.searchsorted(paths.time, rows["time"][k]))
        grain = int(np.searchsorted(paths.ids, rows["id"][k]))
        assert tuple(paths.x[frame, grain]) == (rows["x"][k], rows["y"][k], rows["z"][k])
        assert tuple(paths.v[frame, grain]) == (rows["vx"][k], rows["vy"][k], rows["vz"][k])
    left = np.isnan(paths.x[:, :, 0])
    assert (np.diff(left.astype(int), axis=0) >= 0).all(), "a grain that left does not come back"
    assert (paths.radius == 0.0015).all()
    assert paths.q is None
    assert np.allclose(paths.time, 0.02 * np.arange(len(paths.time)), rtol=1e-9)


def test_plan_run_and_report_tell_how_far_frames_are_apart(found, tmp_path):
    said = "Recorded: seed 1 of each point, a frame every 20 ms from the opening on"
    lab, asked = lab_of(found), found.study
    assert said in lab.plan(asked).lines()
    assert said in repr(lab.run(asked, progress=False))
    assert ("Recorded", "4 runs, with frames 20 ms apart") in setting(found, date.today()).rows
    closer = lab.plan(asked.change({"record": {"every": "1 ms"}}))
    lacks = "has frames every 20 ms, not every 1 ms: runs again for its recording"
    assert closer.frame()["reason"].tolist().count(lacks) == 4
    assert closer.counts()["done"] == 8
    heavy = lab.plan(asked.change({"record": {"every": "100 us"}, "grains.count": 10**6}))
    assert any("record.every: a recorded run takes about" in one for one in heavy.warnings)
    assert not any("record.every" in one for one in closer.warnings)


def test_a_run_writes_its_film(found, tmp_path):
    path = found.run(1).film(tmp_path / "a.gif", colour="speed", seconds=0.1, size=40)
    assert path.read_bytes()[:6] == b"GIF89a"
    with pytest.raises(NotRecorded, match="record"):
        found.run(2, seed=3).film(tmp_path / "b.gif")


@pytest.mark.slow
def test_a_study_may_ask_for_films_which_are_made_once(tmp_path, monkeypatch):
    monkeypatch.setattr("labbook.export.film.film", partial(film, seconds=0.1, size=40))
    lab = labbook.Lab(tmp_path / "lab", "toy")
    asked = study(tmp_path, "record: {every: 20 ms, film: true}", orifices="[24]", replicates=2)
    assert lab.run(asked, progress=False).complete
    (path,) = (tmp_path / "lab/films/toy-study").iterdir()
    assert path.name == "point-1-seed-1-toy-layers.webp"
    (run,) = (run for run in lab.results(asked, progress=False).runs if run.recorded)
    assert is_film_of(path, source_of_film(RunRecord.read(run.folder)))
    before = path.stat().st_mtime_ns
    lab.run(asked, progress=False)
    assert path.stat().st_mtime_ns == before
    path.unlink()
    lab.run(asked, progress=False)
    assert path.exists()


def test_a_run_that_kept_no_frames_says_how_to_keep_them(found):
    with pytest.raises(Exception, match=r"record=.*every"):
        found.run(2, seed=3).trajectories()
    with pytest.raises(LookupError, match=r"\(1, 1\)"):
        found.run(9)


def test_a_raw_table_has_units_and_every_grain_that_left(found):
    run = found.run(1, seed=2)
    frame = run.frame("crossing")
    assert list(frame)[:4] == ["id", "step", "time", "x"]
    assert frame.attrs["units"]["vz"] == "m/s"
    assert len(frame) >= 0.65 * 200
    assert frame["id"].is_unique
    with pytest.raises(LookupError, match="crossing"):
        run.frame("ledger")


def test_results_show_themselves(found):
    assert "D = 18 mm: W = " in repr(found)
    html = found._repr_html_()
    assert "<td>18</td>" in html
    assert "data:image/png;base64," in html
    assert "toy-study" in repr(found.run(1))
    assert "12 finished" in repr(lab_of(found))
    assert repr(found.points[0]).startswith("<PointResult D = 18 mm: 3 runs")
    assert repr(found.series[0]) == "<Series of 4 points; fits: beverloo>"
    assert repr(found.run(1).point) == "<Point 1: orifice 18 mm>"


def test_figures_and_laws_go_by_the_names_of_files_and_pages_as_well(found):
    for file, name in (("flow", "flow_over_time"), ("fit", "flow_rate")):
        assert found.plot(file)._repr_png_() == found.plot(name)._repr_png_()
    assert found.fit("Beverloo") is found.fit("beverloo")


def test_results_of_several_series_show_the_overview(found, monkeypatch):
    """Each angle alone would be a part of the study."""
    from labbook.report import gallery

    drawn = []
    monkeypatch.setattr(gallery, "of_results", lambda results: {"overview": lambda: drawn.append(0) or found.plot()})
    found._repr_html_()
    assert not drawn
    replace(found, series=(*found.series, *found.series))._repr_html_()
    assert drawn == [0]


def test_results_of_two_keys_show_their_map_beside_the_first_figure(found, monkeypatch):
    from labbook.report import gallery

    def draw():
        return found.plot("flow_rate")

    def nothing():
        raise gallery.NothingToShow("map: too few points")

    several = replace(found, series=(*found.series, *found.series))
    for of_map, pictures in ((draw, 2), (nothing, 1)):
        drawings = {"overview": draw, "map": of_map, "against_x": nothing}
        monkeypatch.setattr(gallery, "of_results", lambda results, drawings=drawings: drawings)
        assert several._repr_html_().count("data:image/png;base64,") == pictures


def test_a_lab_without_runs_says_so(tmp_path):
    lab = labbook.Lab(tmp_path / "none", "toy")
    with pytest.warns(labbook.LabWarning, match="there is no lab"):
        results = lab.results(study(tmp_path), progress=False)
    assert "no finished run" in repr(results)
    assert "no finished run" in results._repr_html_()
    assert results.frame().empty
    assert list(results.frame()[["container.orifice", "flow_rate"]]) == ["container.orifice", "flow_rate"]
    with pytest.raises(LookupError, match="no series"):
        results.fit("beverloo")
    assert not (tmp_path / "none").exists()


def test_a_damaged_lab_says_what_to_do(tmp_path):
    (tmp_path / "lab/runs").mkdir(parents=True)
    (tmp_path / "lab/catalogue.db").write_bytes(b"no database")
    lab = labbook.Lab(tmp_path / "lab", "toy")
    assert "labbook reindex" in repr(lab)
    with pytest.raises(labbook.LabError, match="labbook reindex"):
        lab.results(study(tmp_path), progress=False)


def test_a_table_has_its_flow_rates_also_where_there_are_none(tmp_path):
    few = labbook.Lab(tmp_path / "lab", "toy")
    asked = study(tmp_path, orifices="[24]", count=100, replicates=2)
    few.run(asked, progress=False)
    frame = few.results(asked, progress=False).frame()
    assert frame[["flow_rate", "flow_rate_error", "flow_rate_low", "flow_rate_high"]].isna().to_numpy().all()
    assert frame[["runs", "replicates", "flow_rate_n"]].values.tolist() == [[2, 0, 0]]


def test_tables_have_one_of_two_kinds(found, tmp_path):
    with pytest.raises(ValueError, match="kind: 'xls' is none of csv, parquet"):
        found.export(tmp_path / "tables", kind="xls")
    assert not (tmp_path / "tables").exists()


def test_the_runs_of_a_lab_are_a_frame(found):
    frame = lab_of(found).frame()
    assert len(frame) == 12
    assert set(frame["outcome"]) == {"finished"}
    assert len(lab_of(found).frame(limit=5)) == 5
    assert len(lab_of(found).frame(found.study)) == len(lab_of(found).frame(found.study.name)) == 12
    with pytest.raises(ValueError, match="study another; use one of: toy-study"):
        lab_of(found).frame("another")
    with pytest.raises(ValueError, match="no such outcome as finishd; use one of: finished"):
        lab_of(found).frame(outcome="finishd")


@pytest.mark.parametrize("verb", ["plan", "run", "results", "pilot"])
def test_a_path_in_place_of_a_study_says_how_to_read_it(tmp_path, verb):
    with pytest.raises(TypeError, match=r"toy\.yaml'; read a file with labbook\.load"):
        getattr(labbook.Lab(tmp_path / "lab", "toy"), verb)("toy.yaml")
    with pytest.raises(TypeError, match=r"labbook\.load"):
        labbook.define("toy.yaml")  # pyright: ignore[reportArgumentType]


def failing(runner: Runner) -> labbook.Summary:
    """What a study comes to of which a filling failed."""
    plan = Planner(runner.study, Catalogue(runner.lab), runner.backend.capabilities).plan()
    return labbook.Summary(Tally(failed=["the bed is restless"]), plan.points, False, 1.0, 0.0, ())


def test_runs_that_fail_or_are_lost_are_warned_of(tmp_path, monkeypatch):
    asked, lab = study(tmp_path, replicates=1), labbook.Lab(tmp_path / "lab", "toy")
    monkeypatch.setattr("labbook.run.runner.Runner.run", failing)
    with pytest.warns(labbook.LabWarning, match="failed: the bed is restless"):
        assert not lab.run(asked, progress=False).complete
    monkeypatch.undo()
    assert lab.run(asked, progress=False).complete
    victim = next((tmp_path / "lab/runs").iterdir())
    (victim / "crossing.npz").write_bytes(b"damaged")
    for kept in victim.glob("measured-*"):
        remove(kept)
    with pytest.warns(labbook.LabWarning, match=r"crossing\.npz"):
        results = lab.results(asked, progress=False)
    assert len(results.points) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lab.run(asked, progress=False)
        assert len(lab.results(asked, progress=False).points) == 2


def test_a_stopped_run_goes_on(tmp_path, monkeypatch):
    """As Ctrl-C does it: the request to stop is made while runs are going on."""
    asked, lab = study(tmp_path, replicates=1), labbook.Lab(tmp_path / "lab", "toy")
    beats = 0
    advance = type(Backend().open(Backend().specialise(asked.points[0].scene, asked.points[0].numerics), 1)).advance

    def interrupted(self, *given):
        nonlocal beats
        beats += 1
        if beats == 30:
            os.kill(os.getpid(), 2)
        return advance(self, *given)

    with monkeypatch.context() as patch:
        patch.setattr("labbook_toy.Ensemble.advance", interrupted)
        stopped = lab.run(asked, progress=False)
    assert stopped.stopped
    assert not stopped.complete
    assert "run the study again" in repr(stopped)
    summary = lab.run(asked, progress=False)
    assert summary.complete
    assert (summary.done, summary.requested) == (2, 2)


def test_a_notebook_sees_how_it_goes():
    bar = NotebookBar()
    bar.tell("disk <full>")
    going = (ActiveJob("packing, seed 1", "settling", ("0.1 of m g d",)),)
    bar._view = View(1, 4, 2, going, 0, work_done=1e6, work_left=3e6, rate=2e6)
    html = bar.html()
    assert "disk &lt;full&gt;" in html
    assert "1/4 runs, 2 packings first" in html
    assert 'value="1e+06" max="4e+06"' in html
    assert "packing, seed 1" in html
