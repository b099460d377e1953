"""Tables and VTK files of a study."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from toy_results import analyse

from labbook.export.study import NoParquet, moving_walls, write_numbers, write_recordings
from labbook.export.vtk import write_fields, write_grains
from labbook.export.wall_shapes import DrawnWall
from labbook.fields import ContactRows, GrainRows, Layer, Ring, Space, coarse_grain
from labbook.lab.evaluations import evaluate
from labbook.results.frames import frames
from labbook.scene import Clumps, Kind, PartMotion, Spherocylinders, Wall
from labbook.scene.geometry import Mesh
from labbook.study.schema import Reference, ReferenceEntry, Statement


def read_vtk(path):
    """Header lines and arrays by name of a legacy VTK file in binary: enough of the format for what is written here.

    By the format: keywords in lines of ASCII, numbers big-endian behind them, a line feed after each block; texts of a
    field array behind a byte whose two upper bits are set and whose others are their length.
    """
    data, at, found, n = path.read_bytes(), 0, {}, 0

    def line():
        nonlocal at
        end = data.index(b"\n", at)
        text, at = data[at:end].decode("ascii"), end + 1
        return text

    def block(count, kind):
        nonlocal at
        size = {"int": 4, "float": 4, "double": 8}[kind]
        numbers = np.frombuffer(data[at : at + count * size], {"int": ">i4", "float": ">f4", "double": ">f8"}[kind])
        assert data[at + count * size : at + count * size + 1] == b"\n"
        at += count * size + 1
        return numbers.astype(int if kind == "int" else float)

    assert line() == "# vtk DataFile Version 3.0"
    title = line()
    assert len(title) < 256
    assert line() == "BINARY"
    head = {"title": title, "DATASET": line().split()[1]}
    while at < len(data):
        match line().split():
            case ["FIELD", "FieldData", "1"]:
                name, one, count, kind = line().split()
                assert (one, kind) == ("1", "string")
                texts = []
                for _ in range(int(count)):
                    assert data[at] >> 6 == 3
                    length = data[at] & 63
                    texts.append(data[at + 1 : at + 1 + length].decode("ascii"))
                    at += 1 + length
                assert data[at : at + 1] == b"\n"
                at += 1
                head[name] = texts
            case ["POINTS", count, kind]:
                found["points"] = block(3 * int(count), kind).reshape(-1, 3)
            case ["VERTICES" | "POLYGONS" as cells, count, size]:
                corners = {"VERTICES": 1, "POLYGONS": 3}[cells]
                rows = block(int(size), "int").reshape(int(count), corners + 1)
                assert (rows[:, 0] == corners).all()
                found[cells.lower()] = rows[:, 1:]
            case ["DIMENSIONS" | "ORIGIN" | "SPACING" as key, *numbers]:
                head[key] = [float(number) for number in numbers]
            case ["POINT_DATA" | "CELL_DATA", count]:
                n = int(count)
            case ["SCALARS", name, kind, "1"]:
                assert line() == "LOOKUP_TABLE default"
                found[name] = block(n, kind)
            case ["VECTORS" | "TENSORS" as key, name, kind]:
                size = {"VECTORS": 3, "TENSORS": 9}[key]
                found[name] = block(size * n, kind).reshape(n, size)
            case unknown:
                raise AssertionError(unknown)
    return head, found


def test_tables_hold_every_number(analysis):
    found = frames(analysis)
    assert set(found) == {"runs", "points", "series", "fits", "starts", "bands", "budget", "flow", "reference"}
    runs = found["runs"]
    for result in analysis.points:
        for run in result.runs:
            mine = runs[(runs["point"] == result.point.index + 1) & (runs["seed"] == run.seed)]
            assert dict(zip(mine["quantity"], mine["value"], strict=True)) == {
                name: measured.value for name, measured in run.measured.items()
            }
    fits = found["fits"].set_index(["law", "parameter"])
    parameter = analysis.series[0].fits["beverloo"].parameters["k"]
    assert fits.loc[("beverloo", "k"), "low"] == parameter.low
    assert fits.loc[("beverloo", "k"), "aicc"] == analysis.series[0].fits["beverloo"].aicc
    assert len(found["points"]) == sum(len(result.pooled) for result in analysis.points)


@pytest.mark.slow
def test_headings_of_csv_files_have_units_where_they_are_requested(analysis, tmp_path):
    write_numbers(analysis, tmp_path / "plain", "csv")
    write_numbers(analysis, tmp_path / "units", "csv", headings=True)
    plain, with_units = (pd.read_csv(tmp_path / folder / "flow.csv") for folder in ("plain", "units"))
    assert {"time", "flow_rate", "container.orifice"} <= set(plain)
    assert {"time [s]", "flow_rate [kg/s]", "container.orifice [m]", "point"} <= set(with_units)
    assert (with_units.to_numpy() == plain.to_numpy()).all()


def test_bands_run_through_the_points_that_were_fitted(analysis):
    fit, made = analysis.series[0].fits["beverloo"], frames(analysis)["bands"]
    mine = made[made["law"] == "beverloo"].set_index("orifice")
    assert (mine.index[0], mine.index[-1]) == (fit.D.min(), fit.D.max())
    value, low, high = (ends[0] for ends in fit.predict(fit.D[:1]))
    assert mine.iloc[0][["flow_rate", "low", "high"]].tolist() == pytest.approx([value, low, high])
    assert all(wide < low for wide, low in zip(mine["point_low"], mine["low"], strict=True))
    assert all(wide > high for wide, high in zip(mine["point_high"], mine["high"], strict=True))


def test_what_rests_on_several_points_names_them_and_is_stale_with_them(synthetic):
    """One run of the second point is of an older version of the backend."""
    points = [synthetic.point(k, D) for k, D in enumerate((0.02, 0.03, 0.04, 0.05))]
    versions = {(1, 1): 2}
    runs = [
        synthetic.FinishedDouble(one, seed, cache_version=versions.get((one.index, seed), 3))
        for one in points
        for seed in (1, 2)
    ]
    entries = (ReferenceEntry("flow_rate", {"container.orifice": 0.02}, 0.05), ReferenceEntry("beverloo.k", {}, 1.5))
    stated = (Statement("flow_rate", {"container.orifice": 0.03}, 0.0, 1.0, "it flows", "kg/s"),)
    found = analyse(synthetic.study_of(points, reference=Reference("a paper", entries, stated)), runs)
    made = frames(replace(found, installed=("double", 3)))
    assert made["fits"][["points", "stale"]].drop_duplicates().values.tolist() == [["1, 2, 3, 4", True]]
    assert made["series"][["points", "stale"]].values.tolist() == [["1, 2, 3, 4", True]]
    assert made["statements"][["points", "stale"]].values.tolist() == [["2", True]]
    assert made["reference"][["points", "stale"]].values.tolist() == [["1", False], ["1, 2, 3, 4", True]]
    assert set(frames(found)["fits"]["stale"]) == {False}


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_files_give_the_tables_back(analysis, tmp_path, kind):
    pytest.importorskip("pyarrow")
    paths = write_numbers(analysis, tmp_path / "new", kind)
    read = {"csv": pd.read_csv, "parquet": pd.read_parquet}[kind]
    expected = frames(analysis)
    for path in paths:
        # text that is empty comes back as none from CSV
        kept = list(expected[path.stem].select_dtypes("number"))
        found, made = (frame.loc[:, kept] for frame in (read(path), expected[path.stem]))
        pd.testing.assert_frame_equal(found, made, rtol=1e-12)


def test_without_pyarrow_the_remedy_is_named(analysis, tmp_path, monkeypatch):
    def refuse(self, *args, **kwargs):
        raise ImportError("no pyarrow")

    monkeypatch.setattr(pd.DataFrame, "to_parquet", refuse)
    with pytest.raises(NoParquet, match="labbook\\[parquet\\]"):
        write_numbers(analysis, tmp_path, "parquet")


def test_grains_are_points_with_radii_velocities_and_axes(tmp_path):
    rng = np.random.default_rng(1)
    x, v, axis = rng.standard_normal((3, 7, 3))
    write_grains(tmp_path / "a.vtk", "two\nlines", x, 2e-3, {"velocity": v}, axis=axis, length=0.02)
    head, found = read_vtk(tmp_path / "a.vtk")
    assert head["DATASET"] == "POLYDATA"
    for name, expected in (("points", x), ("velocity", v), ("axis", axis)):
        assert np.array_equal(found[name], expected.astype(np.float32))  # single precision
    assert np.array_equal(found["vertices"][:, 0], np.arange(7))
    assert set(found["radius"]) == {float(np.float32(2e-3))}
    assert set(found["length"]) == {float(np.float32(0.02))}
    with pytest.raises(ValueError, match="velocity has 6 numbers and not 3 for each of 7"):
        write_grains(tmp_path / "b.vtk", "", x, 1.0, {"velocity": v[:2]})


GRIDS = [
    Layer((-0.02, 0.01), (0.0, 0.03), 30, 20, 3e-3),
    Space((-0.02, 0.01), (0.0, 0.02), (0.0, 0.03), 9, 8, 7),
    Ring(0.02, (0.0, 0.03), 12, 15),
]


@pytest.mark.parametrize("grid", GRIDS, ids=lambda grid: type(grid).__name__)
def test_fields_lie_at_their_points(grid, tmp_path):
    """The point of the highest density is that of the grain; values are read back where they belong."""
    x = np.array([[0.004, 0.012, 0.02]])
    branch, force = np.array([[1e-3, 2e-3, 0]]), np.array([[1.0, 2, 3]])
    grains = GrainRows(x, np.array([[1.0, 2.0, 3.0]]), 1e-5, 1e-8, 1, np.array([[0.6, 0.0, 0.8]]))
    fields = coarse_grain(grid, 2e-3, grains, ContactRows(x, branch, force, 1))
    write_fields(tmp_path / "f.vtk", "fields", fields)
    head, found = read_vtk(tmp_path / "f.vtk")
    counts = [int(count) for count in head["DIMENSIONS"]]
    k = int(np.argmax(found["density"]))
    index = np.array([k % counts[0], k // counts[0] % counts[1], k // (counts[0] * counts[1])])
    place = np.array(head["ORIGIN"]) + index * head["SPACING"]
    at = {"Layer": [0.004, 0, 0.02], "Space": x[0], "Ring": [np.hypot(0.004, 0.012), 0, 0.02]}[type(grid).__name__]
    assert (abs(place - at) <= 0.6 * np.array(head["SPACING"]) + 1e-12).all()
    assert found["density"][k] == pytest.approx(fields.density.max(), rel=1e-8)
    assert len(found["density"]) == fields.density.size
    place = np.unravel_index(np.argmax(fields.density), fields.density.shape)
    np.testing.assert_allclose(found["velocity"][k], fields.velocity[(slice(None), *place)], rtol=1e-8)
    stress = fields.contact_stress
    assert stress is not None
    np.testing.assert_allclose(
        found["contact_stress"][k], stress[(slice(None), slice(None), *place)].ravel(), rtol=1e-8
    )
    assert found["nematic_order"][k] == pytest.approx(fields.nematic_order[place], rel=1e-8)


def test_recorded_runs_are_series_of_files(synthetic, tmp_path):
    point = synthetic.point(0, 0.03)
    runs = [synthetic.FinishedDouble(point, seed, recorded=seed == 2) for seed in (1, 2)]
    paths = write_recordings(analyse(synthetic.study_of([point]), runs), tmp_path)
    table = runs[1].recording()
    times = np.unique(table["time"])
    series, *files, walls, means = paths
    assert [path.name for path in files] == [f"grains-{k:04d}.vtk" for k in range(len(times))]
    entries = json.loads(series.read_text())["files"]
    assert series.name == "grains.vtk.series"
    assert [entry["name"] for entry in entries] == [path.name for path in files]
    assert [entry["time"] for entry in entries] == pytest.approx(times)
    for k in (0, 7, len(times) - 1):
        _, found = read_vtk(files[k])
        now = table["time"] == times[k]
        assert sorted(found["id"]) == sorted(table["id"][now])
        np.testing.assert_allclose(np.sort(found["points"][:, 2]), np.sort(table["z"][now]), rtol=1e-6)
    head, _ = read_vtk(means)
    assert head["DATASET"] == "STRUCTURED_POINTS"
    head, found = read_vtk(walls)
    hopper = point.scene.container
    assert head["wall_names"] == [wall.name for wall in hopper.walls()]
    assert set(found["wall"]) == set(range(len(hopper.walls())))
    assert len(found["polygons"]) == len(found["wall"])
    assert found["polygons"].max() == len(found["points"]) - 1
    # each wall lies where its distance is zero, to single precision
    for number, wall in enumerate(hopper.walls()):
        corners = found["points"][np.unique(found["polygons"][found["wall"] == number])]
        assert np.abs(wall.shape.distance(corners)).max() < 1e-7


def test_unlike_grains_have_radii_and_kinds_of_their_own(synthetic, tmp_path):
    point = synthetic.point(0, 0.03)
    kinds = (Kind(name="large", share=0.5), Kind(name="small", share=0.5, diameter=0.002))
    grains = point.scene.grains.model_copy(update={"kinds": kinds})
    point = replace(point, scene=point.scene.model_copy(update={"grains": grains}))

    class Mixed:
        def __init__(self):
            self.run = synthetic.FinishedDouble(point, 1, recorded=True)

        def __getattr__(self, name):
            return getattr(self.run, name)

        def evaluated(self, measure, window):
            return evaluate(measure, window, self.data())

        def data(self):
            found = self.run.data()
            kind = np.arange(len(found.start)) % 2
            start = replace(found.start, kind=kind, diameter=np.where(kind == 0, 0.003, 0.002))
            return replace(found, start=start)

    runs: Any = [Mixed()]
    (_, first, *others) = write_recordings(analyse(synthetic.study_of([point]), runs), tmp_path)
    means = [path.name for path in others if "fields" in path.name]
    assert means == ["point-1-fields.vtk", *(f"point-1-fields-{kind.name}.vtk" for kind in point.scene.grains.kinds)]
    head, found = read_vtk(first)
    assert head["kind_names"] == ["large", "small"]
    assert head["title"].endswith("kinds: 0 large, 1 small")
    assert set(found["kind"]) == {0, 1}
    np.testing.assert_allclose(found["radius"], np.where(found["id"] % 2 == 0, 0.0015, 0.001), rtol=1e-7)
    np.testing.assert_array_equal(found["kind"], found["id"] % 2)


def test_every_rod_of_a_recorded_run_is_there_with_its_axis_and_length(synthetic, tmp_path):
    """A turn by an angle about the y axis takes the z axis to (sin, 0, cos) of it: another one for each rod."""
    point = synthetic.point(0, 0.03)
    rods = Spherocylinders(diameter=0.003, length=0.009, density=2500, count=point.scene.grains.count)
    point = replace(point, scene=point.scene.model_copy(update={"grains": rods}))
    angle = 1e-3 * np.arange(rods.count)

    class Rods:
        def __init__(self):
            self.run = synthetic.FinishedDouble(point, 1, recorded=True)

        def __getattr__(self, name):
            return getattr(self.run, name)

        def data(self):
            return replace(self.run.data(), recorded=self.recording)

        def recording(self):
            table, zero = self.run.recording(), np.zeros
            turn = angle[table["id"]] / 2
            return table | {"qw": np.cos(turn), "qx": zero(len(turn)), "qy": np.sin(turn), "qz": zero(len(turn))}

    runs: Any = [Rods()]
    table = runs[0].recording()
    (_, *files) = write_recordings(analyse(synthetic.study_of([point]), runs), tmp_path)
    times = np.unique(table["time"])
    for k in (0, len(times) - 1):
        _, found = read_vtk(files[k])
        now = table["time"] == times[k]
        assert sorted(found["id"]) == sorted(table["id"][now])
        order = found["id"].astype(int)
        np.testing.assert_allclose(
            found["axis"], np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)[order], atol=1e-6
        )
        assert set(found["length"]) == {float(np.float32(0.009))}
        assert set(found["radius"]) == {float(np.float32(0.0015))}


def test_every_sphere_of_a_recorded_clump_is_there_with_the_axes_of_its_clump(synthetic, tmp_path):
    """A turn by an angle about the y axis takes z to (sin, 0, cos) of it, and x to (cos, 0, -sin)."""
    point = synthetic.point(0, 0.03)
    clumps = Clumps(
        diameter=0.003, centres=((0.0, 0, 0), (0.0, 0, 0.002)), diameters=(0.003, 0.002), density=2500,
        count=point.scene.grains.count,
    )  # fmt: skip
    point = replace(point, scene=point.scene.model_copy(update={"grains": clumps}))
    angle = 1e-3 * np.arange(clumps.count)

    class Recorded:
        def __init__(self):
            self.run = synthetic.FinishedDouble(point, 1, recorded=True)

        def __getattr__(self, name):
            return getattr(self.run, name)

        def data(self):
            return replace(self.run.data(), recorded=self.recording)

        def recording(self):
            table, zero = self.run.recording(), np.zeros
            turn = angle[table["id"]] / 2
            return table | {"qw": np.cos(turn), "qx": zero(len(turn)), "qy": np.sin(turn), "qz": zero(len(turn))}

    runs: Any = [Recorded()]
    table = runs[0].recording()
    (_, *files) = write_recordings(analyse(synthetic.study_of([point]), runs), tmp_path)
    _, found = read_vtk(files[0])
    now = table["time"] == table["time"].min()
    ids, turn = table["id"][now], angle[table["id"][now]]
    assert found["id"].tolist() == np.repeat(ids, 2).tolist()
    assert found["sphere"].tolist() == [0, 1] * len(ids)
    assert found["radius"] == pytest.approx(np.tile([0.0015, 0.001], len(ids)))
    axis = np.stack([np.sin(turn), 0 * turn, np.cos(turn)], axis=1)
    np.testing.assert_allclose(found["axis"], np.repeat(axis, 2, axis=0), atol=1e-6)
    first = np.stack([np.cos(turn), 0 * turn, -np.sin(turn)], axis=1)
    np.testing.assert_allclose(found["first_axis"], np.repeat(first, 2, axis=0), atol=1e-6)
    low, high = found["points"][::2], found["points"][1::2]
    np.testing.assert_allclose(high - low, 0.002 * axis, atol=1e-7)


def test_walls_are_written_for_each_frame_only_where_a_part_moves(tmp_path):
    sheet_at_rest = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    still = DrawnWall("floor", sheet_at_rest, (0, 0, 0, 0), 0.0)
    wall = Wall.of(name="plate", shape=None, motion=None, opens=None, moves=PartMotion(velocity=(0.0, 0.0, 2.0)))
    rising = replace(still, name="plate", part=wall)
    assert moving_walls(tmp_path, [still], np.array([0.0, 0.5]), "") == []
    series, first, last = moving_walls(tmp_path, [still, rising], np.array([0.0, 0.5]), "")
    assert series.name == "walls.vtk.series"
    points = [path.read_bytes().split(b"POINTS 6 float\n")[1][: 6 * 12] for path in (first, last)]
    before, after = (np.frombuffer(block, ">f4").reshape(6, 3) for block in points)
    assert (after - before).tolist() == [[0, 0, 0]] * 3 + [[0, 0, 1]] * 3
    gone = replace(rising, part=Wall.of(name="plate", shape=None, motion=None, opens=0.4, moves=wall.moves))
    early, late = (mesh.vertices for mesh in gone.at([0.3, 0.5]))
    assert np.ptp(early, axis=0).tolist() == [1.0, 1.0, 0.0]
    assert np.ptp(late, axis=0).tolist() == [0.0, 0.0, 0.0], "what has vanished is a point where it was placed"
