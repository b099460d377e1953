"""Recordings hold the grains, the walls and W(t) on one clock."""

import sys
from dataclasses import replace

import labbook_reference
import numpy as np
import pytest

from labbook.backend.numerics import Numerics
from labbook.checks.verify.materials import linear, scene
from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.checks.verify.platform import grains_at
from labbook.export.colour_bar import speed_colours, speed_ticks
from labbook.export.entities import CLOCK, Steady, ViewerMissing, log_grains, paths_of
from labbook.export.forces import PairForces, pair_forces
from labbook.export.frames import FRAMES, Frame, NotRecorded, frames_of, frames_of_run, top_speed
from labbook.export.recording import RecordedRun, flow_curves, write
from labbook.export.views import seen_from
from labbook.export.wall_shapes import drawn_walls
from labbook.picture import layer_colours
from labbook.scene import (
    Box,
    Clumps,
    CylinderSilo,
    LinearSpringDashpot,
    Packing,
    PartMotion,
    PartRotation,
    Primitives,
    Scene,
    Spherocylinders,
    WedgeHopper,
)

rerun = pytest.importorskip("rerun")


@pytest.fixture
def run(synthetic):
    return synthetic.observe(synthetic.scene(), seed=1, recorded=True)


def chunks(path):
    """(entity, static?, rows, columns) of all that a recording holds, and its chunks by entity."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(str(path)).stream():
        found.setdefault((chunk.entity_path, chunk.is_static), []).append(chunk)
    return found


def column(parts, name):
    """Values of one column of an entity over all its chunks, one array a row."""
    rows = []
    for part in parts:
        batch = part.to_record_batch()
        rows += [np.array(cell.as_py()) for cell in batch.column(batch.schema.names.index(name))]
    return rows


def test_every_frame_has_the_grains_of_that_time(run, tmp_path):
    found = chunks(write([RecordedRun.of(run, run.tables["sample"], "a")], tmp_path / "a.rrd", "1" * 16))
    parts = found["/grains", False]
    assert all(CLOCK in part.timeline_names for part in parts)
    times, starts = np.unique(run.tables["sample"]["time"], return_index=True)
    counts = np.diff([*starts, len(run.tables["sample"]["time"])])
    positions, colours = column(parts, "Points3D:positions"), column(parts, "Points3D:colors")
    assert sorted(map(len, positions)) == sorted([*counts, 0])  # in the end the silo is empty
    assert sorted(map(len, colours)) == sorted([*counts, 0])
    fullest = max(positions, key=len)
    first = np.stack([run.tables["sample"][c][: counts[0]] for c in ("x", "y", "z")], axis=1)
    np.testing.assert_allclose(np.array(fullest), first, atol=1e-7)
    assert len(times) == 30


def rgb(packed) -> np.ndarray:
    """Colours [n, 3] of a row as rerun stores them, 0xRRGGBBAA."""
    packed = np.asarray(packed, np.uint32)
    return np.stack([(packed >> shift) & 255 for shift in (24, 16, 8)], axis=-1)


def test_grains_carry_their_layers_and_beside_them_their_speeds(run, tmp_path):
    """Tabs of the viewer choose between the two columns of colours."""
    table = run.tables["sample"]
    parts = chunks(write([RecordedRun.of(run, table, "a")], tmp_path / "a.rrd", "1" * 16))["/grains", False]
    by_layer, by_speed = (max(column(parts, f"{name}:colors"), key=len) for name in ("Points3D", "speed"))
    first = table["time"] == 0
    frame = frames_of(table)[0]
    fastest = top_speed(run.scene, frames_of_run(run, table, FRAMES))
    assert np.abs(rgb(by_speed) - speed_colours(frame.speed, fastest)[:, :3].astype(int)).max() <= 1
    layers = np.rint(255 * layer_colours(run.scene, run.start, run.start.rows(table["id"][first])))
    assert (rgb(by_layer) == layers).all()


def test_contact_forces_are_lines_between_centres(run, tmp_path):
    """Two contacts in the first of 30 frames, none in the others; the larger force has the thicker line."""
    ends = np.array([[[0, 0, 0.01], [0, 0, 0.013]], [[0.01, 0, 0.02], [0.012, 0, 0.022]]])

    def forces(frame):
        there = frame.time == 0
        return PairForces(ends[: 2 * there], np.array([0.2, 1.0])[: 2 * there])

    table = run.tables["sample"]
    found = chunks(write([RecordedRun.of(run, table, "a", forces=forces)], tmp_path / "a.rrd", "1" * 16))
    strips, radii = (column(found["/forces", False], f"LineStrips3D:{name}") for name in ("strips", "radii"))
    assert sorted(map(len, strips)) == [0] * 30 + [2]  # with the empty silo at the end
    assert np.array(max(strips, key=len)) == pytest.approx(ends, abs=1e-8)
    thin, thick = max(radii, key=len)
    assert thick == pytest.approx(0.2 * run.scene.grains.diameter)  # a fifth of a diameter for the largest
    assert thin < 0.3 * thick
    without = chunks(write([RecordedRun.of(run, table, "a")], tmp_path / "b.rrd", "1" * 16))
    assert "/forces" not in {path for path, _ in without}


def test_velocities_are_arrows_from_centres(run, tmp_path):
    """The arrow of a grain at the upper end of the speeds is four diameters long, others in proportion."""
    table = run.tables["sample"]
    parts = chunks(write([RecordedRun.of(run, table, "a")], tmp_path / "a.rrd", "1" * 16))["/velocities", False]
    origins, vectors = (max(column(parts, f"Arrows3D:{name}"), key=len) for name in ("origins", "vectors"))
    frame = frames_of(table)[0]
    fastest = top_speed(run.scene, frames_of_run(run, table, FRAMES))
    np.testing.assert_allclose(np.array(origins), frame.x, atol=1e-7)
    np.testing.assert_allclose(np.array(vectors), frame.v * 4 * run.scene.grains.diameter / fastest, atol=1e-6)


def test_a_path_ends_where_a_grain_was_put_back():
    """It falls with 1 m/s for 0.03 s; 0.3 m higher it begins again. Another grain is there in one frame only."""
    z = np.array([0.10, 0.09, 0.08, 0.38, 0.37])
    frames = [
        Frame(0.01 * k, np.array([[0, 0, z[k]]] + [[1, 0, 0]] * (k == 2), np.float32),
              np.array([[0, 0, -1]] + [[0, 0, 0]] * (k == 2), float), np.array([7, 8][: 1 + (k == 2)]))
        for k in range(5)
    ]  # fmt: skip
    paths = paths_of(frames, np.array([7, 8]), 0.003)
    assert [one for one, _ in paths] == [7, 7]
    np.testing.assert_allclose(paths[0][1][:, 2], z[:3], atol=1e-7)
    np.testing.assert_allclose(paths[1][1][:, 2], z[3:], atol=1e-7)


def test_a_path_ends_at_periodic_sides_and_lines_of_force_go_on_beyond_them():
    y = np.array([0.008, 0.009, -0.010, -0.009])
    frames = [Frame(0.001 * k, np.array([[0, y[k], 0]], np.float32), np.array([[0.0, 1.0, 0.0]]), np.array([3]))
              for k in range(4)]  # fmt: skip
    parts = [path[:, 1] for _, path in paths_of(frames, np.array([3]), 0.003, 0.02)]
    assert [part.tolist() for part in parts] == [pytest.approx(y[:2]), pytest.approx(y[2:])]
    silo = WedgeHopper(width=0.06, height=0.2, thickness=0.02, orifice=0.02, periodic="y")
    of = scene(2, linear(), silo)
    start = grains_at([[0.0, 0.009, 0.01], [0.0, -0.0085, 0.01]])
    frame = Frame(0.0, start.x.astype(np.float32), start.v, np.arange(2))
    (ends,), size = pair_forces(labbook_reference.Backend(), of, Numerics(dt=1e-6), start, frame)
    assert size > 0
    assert ends[:, 1] == pytest.approx([0.009, 0.0115], abs=1e-8)


def test_the_window_is_a_box_as_high_as_the_mean(run, tmp_path):
    steady = Steady(0.1, 0.3, 50.0, 1.5)
    path = write([RecordedRun.of(run, run.tables["sample"], "a", steady=steady)], tmp_path / "a.rrd", "1" * 16)
    found = chunks(path)
    assert np.concatenate(column(found["/flow_rate/window", False], "Scalars:scalars")).tolist() == [0, 50, 50, 0]
    (name,) = column(found["/flow_rate/window", True], "SeriesLines:names")
    assert name.tolist() == ["mean: 50.0 ± 1.5 g/s"]
    (curve,) = flow_curves(path)
    assert curve.window == pytest.approx((0.1, 0.3))
    assert curve.time[-1] == pytest.approx(run.duration, rel=1e-6)


def test_two_runs_are_on_one_clock(synthetic, tmp_path):
    """A view for each, below entities of its own, and both curves in one chart with the names of the runs."""
    runs = [synthetic.observe(synthetic.scene(orifice=width), seed=1, recorded=True) for width in (0.03, 0.024)]
    recorded = [
        RecordedRun.of(one, one.tables["sample"], name) for one, name in zip(runs, ("wide", "narrow"), strict=True)
    ]
    path = write(recorded, tmp_path / "a.rrd", "1" * 16)
    found = chunks(path)
    for number, one in enumerate(runs, 1):
        parts = found[f"/run-{number}/grains", False]
        assert all(CLOCK in part.timeline_names for part in parts)
        assert max(map(len, column(parts, "Points3D:positions"))) == len(one.start)
    assert [curve.name for curve in flow_curves(path)] == ["wide", "narrow"]


def test_a_recording_whose_frames_begin_late_shows_the_packing_first(run, tmp_path):
    whole = run.tables["sample"]
    later = whole["time"] > 0
    table = {name: values[later] for name, values in whole.items()}
    parts = chunks(write([RecordedRun.of(run, table, "a")], tmp_path / "a.rrd", "1" * 16))["/grains", False]
    whole_beds = [one for one in column(parts, "Points3D:positions") if len(one) == len(run.start)]
    assert any(np.allclose(one, run.start.x, atol=1e-7) for one in whole_beds)
    assert sum(part.num_rows for part in parts) == len(np.unique(whole["time"])) + 1  # the last one is empty


def test_walls_and_flow_rate_are_there(run, tmp_path):
    found = chunks(write([RecordedRun.of(run, run.tables["sample"], "a")], tmp_path / "a.rrd", "1" * 16))
    for wall in run.scene.container.walls():
        assert (f"/walls/{wall.name}", True) in found
    parts = found["/flow_rate", False]
    rate = np.concatenate(column(parts, "Scalars:scalars"))
    assert all(CLOCK in part.timeline_names for part in parts)
    assert np.median(rate) == pytest.approx(1e3 * 0.0555, rel=0.03)  # g/s: Beverloo's law for this scene


@pytest.mark.parametrize(("positions", "shown"), [(10**9, 2 * FRAMES), (0, 2 * FRAMES // 3)])
def test_a_small_bed_has_all_frames_and_a_large_one_evenly_chosen_ones(
    synthetic, run, tmp_path, monkeypatch, positions, shown
):
    """Every second of them would be one too many, as the empty silo is shown last."""
    monkeypatch.setattr("labbook.export.recording.POSITIONS", positions)
    table = synthetic.sample(run.scene, run.tables["crossing"], frames=2 * FRAMES - 1)
    parts = chunks(write([RecordedRun.of(run, table, "a")], tmp_path / "a.rrd", "1" * 16))["/grains", False]
    assert sum(part.num_rows for part in parts) == shown + (shown < 2 * FRAMES)
    kept = [frame.time for frame in frames_of(table, shown)]
    assert np.allclose(np.diff(kept), kept[1])


def test_it_is_put_in_place_whole(run, tmp_path, monkeypatch):
    path = tmp_path / "deep" / "a.rrd"
    write([RecordedRun.of(run, run.tables["sample"], "a")], path, "1" * 16)
    assert [p.name for p in path.parent.iterdir()] == ["a.rrd"]
    before = path.read_bytes()
    monkeypatch.setattr("labbook.export.recording.send_flow_rate", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write([RecordedRun.of(run, run.tables["sample"], "a")], path, "1" * 16)
    assert [p.name for p in path.parent.iterdir()] == ["a.rrd"]
    assert path.read_bytes() == before


@pytest.mark.parametrize("table", [None, {"time": np.zeros(0)}])
def test_a_run_without_frames_is_an_error_that_says_what_to_add(run, table, tmp_path):
    with pytest.raises(NotRecorded, match="add `record"):
        write([RecordedRun.of(run, table, "a")], tmp_path / "a.rrd", "1" * 16)


def test_without_rerun_the_error_names_the_remedy(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ViewerMissing, match=r"pip install 'labbook\[viewer\]'"):
        write([RecordedRun.of(run, run.tables["sample"], "a")], tmp_path / "a.rrd", "1" * 16)
    assert not list(tmp_path.iterdir())


def test_faster_grains_are_brighter():
    colours = speed_colours(np.array([0, 0.01, 0.1, 0.5, 1.0, 5.0]), 1.0).astype(float)
    luminance = colours[:, :3] @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance[:5]) > 5).all()
    assert (colours[4] == colours[5]).all()
    assert (speed_colours(np.zeros(3), 0.0) == colours[0]).all()


def test_a_bed_at_rest_is_not_shown_as_moving(synthetic):
    """Its grains tremble at 1e-8 m/s; a hundredth of sqrt(g d) = 1.7 mm/s is what the brightest colour is at least."""
    rest = [Frame(0.0, np.zeros((50, 3), np.float32), np.full((50, 3), (1e-8, 0, 0)), np.arange(50))]
    assert top_speed(synthetic.scene(), rest) == pytest.approx(0.01 * np.sqrt(9.81 * 0.003))
    flowing = [rest[0]._replace(v=np.full((50, 3), (0, 0, -0.3)))]
    assert top_speed(synthetic.scene(), flowing) == pytest.approx(0.3)


@pytest.mark.parametrize("top", [1e-3, 0.0213, 0.1, 0.61, 5.0, 10.0])
def test_numbers_of_the_colour_bar_are_round_and_apart(top):
    ticks = speed_ticks(top)
    places = np.sqrt(np.array(ticks) / top)
    assert (ticks[0], ticks[-1]) == (0, top)
    assert len(ticks) >= 5
    assert np.diff(places).min() >= 0.06
    assert all(f"{tick:e}"[0] in "125" and set(f"{tick:e}"[1:8]) <= set(".0") for tick in ticks[1:-1])


def test_walls_lie_where_the_container_has_them(run):
    positions = run.start.x
    quads = {wall.name: wall.mesh.vertices for wall in drawn_walls(run.scene, positions)}
    assert set(quads) == {wall.name for wall in run.scene.container.walls()}
    assert np.allclose(quads["left"][:, 0], -0.05)
    assert np.allclose(quads["bottom-right"][:, 2], 0)
    assert sorted(quads["bottom-right"][:, 0]) == pytest.approx([0.015, 0.015, 0.05, 0.05])
    # Plates are cut a little above the grains, not drawn to the top of the silo.
    assert quads["left"][:, 2].max() < positions[:, 2].max() + 0.01
    assert np.allclose(quads["back"][:, 1], 0.00303 / 2)


def test_panes_of_a_hopper_end_where_its_plates_do(synthetic):
    """However far grains have fallen below the outlet, and also beside an inclined bottom."""
    scene = synthetic.scene(angle=np.pi / 4)
    grains = np.vstack([synthetic.lattice(scene).x, [[0, 0, -0.05]]])
    walls = {wall.name: wall.mesh.vertices for wall in drawn_walls(scene, grains)}
    pane = walls["front"]
    assert pane[:, 2].min() == pytest.approx(0)
    assert np.allclose(pane[:, 1], -scene.container.thickness / 2)
    plates = np.vstack([walls[name] for name in ("left", "right", "bottom-left", "bottom-right")])
    (x, z), rim = pane[:, [0, 2]].T, plates[:, [0, 2]]
    assert all(np.linalg.norm(rim - corner, axis=1).min() < 1e-12 for corner in zip(x, z, strict=True))
    # A hexagon: 35 mm below each of its upper, vertical sides the plates go in at 45 degrees to an outlet of 30 mm.
    area = abs(np.dot(x, np.roll(z, 1)) - np.dot(z, np.roll(x, 1))) / 2
    assert area == pytest.approx(0.1 * (z.max() - 0.035) + 0.035 * (0.1 + 0.03) / 2)


@pytest.mark.parametrize("kind", ["flat hopper", "inclined hopper", "cylinder", "rods", "box"])
def test_all_grains_and_walls_are_in_view_and_fill_it(synthetic, kind):
    """The eye's field of view is 55 degrees high; a window is at least 0.9 times as wide as high."""
    here = synthetic.scene()
    changed = {
        "flat hopper": here,
        "inclined hopper": synthetic.scene(angle=np.pi / 4),
        "cylinder": here.model_copy(
            update={"container": CylinderSilo(diameter=0.1, height=0.5, orifice=0.03, rotation=1.0)}
        ),
        "rods": here.model_copy(
            update={
                "container": CylinderSilo(diameter=0.1, height=0.5, orifice=0.03),
                "grains": Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=300),
            }
        ),
        "box": here.model_copy(update={"container": Box(width=0.1, depth=0.1, height=0.1)}),
    }[kind]
    grains = np.random.default_rng(1).uniform((-0.04, -0.001, -0.01), (0.04, 0.001, 0.1), (300, 3))
    eye, target = seen_from(changed, grains)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
    up = np.cross(right, forward)
    assert (forward[2] == 0) == ("hopper" in kind)  # quasi-2D: straight from the front
    size = 10e-3 if kind == "rods" else 1.5e-3
    ways = np.random.default_rng(2).normal(size=(100, 3))
    around = (grains[:, None] + size * ways / np.linalg.norm(ways, axis=1)[:, None]).reshape(-1, 3)
    walls = [wall.mesh.vertices for wall in drawn_walls(changed, grains)]
    seen = np.concatenate([around, *walls]) - eye
    high = np.abs(seen @ up) / (seen @ forward) / np.tan(np.radians(55 / 2))
    wide = np.abs(seen @ right) / (seen @ forward) / np.tan(np.radians(55 / 2)) / 0.9
    assert (seen @ forward).min() > 0
    assert 0.8 < max(high.max(), wide.max()) < 1


def test_walls_of_a_box_are_patches_of_their_planes(synthetic):
    box = Box(width=0.1, depth=0.1, height=0.1)
    scene = synthetic.scene().model_copy(update={"container": box})
    grains = np.array([[-0.04, -0.03, 0.01], [0.04, 0.03, 0.09]])
    quads = {wall.name: wall.mesh.vertices for wall in drawn_walls(scene, grains)}
    assert np.allclose(quads["bottom"][:, 2], 0)
    assert np.ptp(quads["bottom"][:, 0]) == pytest.approx(0.083)
    assert np.ptp(quads["bottom"][:, 1]) == pytest.approx(0.063)
    assert np.allclose(quads["right"][:, 0], 0.05)


def test_rods_are_capsules_and_the_bottom_turns(synthetic, tmp_path):
    """A rod of 20 mm x 6 mm at (1, 2, 3) cm that lies along x: its capsule begins 7 mm before it."""
    rods = Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=1)
    silo = CylinderSilo(diameter=0.19, height=0.5, orifice=0.06, rotation=0.25)
    scene = synthetic.scene().model_copy(update={"grains": rods, "container": silo})
    run = synthetic.observe(synthetic.scene(), seed=1, recorded=True)
    run = replace(run, scene=scene, tables={})
    columns = {"id": 0, "x": 0.01, "y": 0.02, "z": 0.03, "vx": 0.1, "vy": 0, "vz": 0}
    columns |= dict(zip(("qw", "qx", "qy", "qz"), (np.sqrt(0.5), 0, np.sqrt(0.5), 0), strict=True))
    table = {"time": np.array([0.0, 1.0]), **{name: np.full(2, value) for name, value in columns.items()}}
    found = chunks(write([RecordedRun.of(run, table, "a")], tmp_path / "a.rrd", "1" * 16))
    (first, _) = column(found["/grains", False], "Capsules3D:translations")
    assert np.ravel(column(found["/grains", True], "Capsules3D:fill_mode")) == [3]  # solid
    assert np.array(first[0]) == pytest.approx([0.003, 0.02, 0.03], abs=1e-7)
    (_, turned) = column(found["/walls/bottom", False], "Transform3D:quaternion")
    assert np.ravel(turned) == pytest.approx([0, 0, np.sqrt(0.5), np.sqrt(0.5)], abs=1e-6)  # a quarter turn


def test_clumps_are_points_one_for_each_sphere(synthetic, tmp_path):
    clump = Clumps(
        diameter=6e-3, centres=((0.0, 0, -2e-3), (0.0, 0, 3e-3)), diameters=(6e-3, 4e-3), density=620, count=5
    )
    silo = CylinderSilo(diameter=0.19, height=0.5, orifice=0.06)
    scene = synthetic.scene().model_copy(update={"grains": clump, "container": silo})
    run = replace(synthetic.observe(synthetic.scene(), seed=1), scene=scene, tables={}, outcome="emptied", duration=1.0)
    counts, rng = [5, 2], np.random.default_rng(1)
    q = rng.normal(size=(sum(counts), 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    table = dict(zip(("qw", "qx", "qy", "qz"), q.T, strict=True))
    table |= {name: rng.uniform(0, 0.05, sum(counts)) for name in ("x", "y", "z", "vx", "vy", "vz")}
    table |= {"time": np.repeat([0.0, 0.4], counts), "id": np.concatenate([np.arange(n) for n in counts])}
    parts = chunks(write([RecordedRun.of(run, table, "a")], tmp_path / "a.rrd", "1" * 16))["/grains", False]
    for name in ("positions", "radii", "colors"):
        assert [len(row) for row in column(parts, f"Points3D:{name}")] == [10, 4, 0], name
    assert np.concatenate(column(parts, "Points3D:radii")) == pytest.approx(np.tile([3e-3, 2e-3], 7))
    # both spheres lie on the z axis of the body, 5 mm apart
    w, x, y, z = q.T
    along = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)
    rows = [np.reshape(row, (-1, 3)) for row in column(parts, "Points3D:positions")]
    ends = np.concatenate(rows).reshape(7, 2, 3)
    assert ends[:, 1] - ends[:, 0] == pytest.approx(5e-3 * along, abs=1e-8)
    at = np.column_stack([table[name] for name in "xyz"])
    assert ends[:, 0] - at == pytest.approx(clump.spheres[0].centre[2] * along, abs=1e-8)


def test_every_frame_has_a_length_and_a_radius_for_every_rod(synthetic, tmp_path):
    """The viewer draws as many capsules as there are lengths: also after rods have left, and none when all have."""
    rods = Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=5)
    silo = CylinderSilo(diameter=0.19, height=0.5, orifice=0.06)
    scene = synthetic.scene().model_copy(update={"grains": rods, "container": silo})
    run = replace(synthetic.observe(synthetic.scene(), seed=1), scene=scene, tables={}, outcome="emptied", duration=1.0)
    counts, rng = [5, 4, 2], np.random.default_rng(1)
    q = rng.normal(size=(sum(counts), 4))
    table = dict(zip(("qw", "qx", "qy", "qz"), (q / np.linalg.norm(q, axis=1)[:, None]).T, strict=True))
    table |= {name: rng.uniform(0, 0.05, sum(counts)) for name in ("x", "y", "z", "vx", "vy", "vz")}
    table |= {"time": np.repeat([0.0, 0.4, 0.8], counts), "id": np.concatenate([np.arange(n) for n in counts])}
    parts = chunks(write([RecordedRun.of(run, table, "a")], tmp_path / "a.rrd", "1" * 16))["/grains", False]
    for name in ("lengths", "radii", "translations", "quaternions", "colors"):
        assert [len(row) for row in column(parts, f"Capsules3D:{name}")] == [*counts, 0], name
    assert np.concatenate(column(parts, "Capsules3D:lengths")) == pytest.approx(np.full(sum(counts), 14e-3))
    assert np.concatenate(column(parts, "Capsules3D:radii")) == pytest.approx(np.full(sum(counts), 3e-3))


def test_lengths_of_rods_cost_next_to_nothing(tmp_path):
    """42 bytes a rod and frame: 12 of place, 16 of orientation, twice 4 of colours, of layers less; the rest packed."""
    rods = Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=500)
    scene = Scene(
        grains=rods,
        contact=LinearSpringDashpot(normal_stiffness=1.0),
        container=CylinderSilo(diameter=0.19, height=0.5, orifice=0.06),
    )
    rng = np.random.default_rng(1)
    x = rng.uniform(0, 0.05, (500, 3))
    start = Packing(x=x, v=np.zeros_like(x), omega=np.zeros_like(x))
    frames = []
    for time in np.linspace(0, 1, 40):
        q = rng.normal(size=(500, 4))
        place = rng.uniform(0, 0.05, (500, 3)).astype(np.float32)
        frames.append(Frame(time, place, rng.uniform(0, 1, (500, 3)), np.arange(500), q))
    stream = rerun.RecordingStream("labbook", recording_id="size")
    stream.save(tmp_path / "a.rrd")
    log_grains(stream, "", scene, start, frames, 1.0)
    stream.flush()
    stream.disconnect()
    assert (tmp_path / "a.rrd").stat().st_size < 42 * 500 * 40


def test_round_walls_are_meshes_of_their_surface():
    silo = CylinderSilo(diameter=0.19, height=0.5, orifice=0.06, rotation=0.25)
    rods = Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=1)
    law = LinearSpringDashpot(normal_stiffness=1.0)
    scene = Scene(grains=rods, contact=law, container=silo)
    walls = list(drawn_walls(scene, np.array([[0, 0, 0.1]])))
    side, bottom = (wall.mesh for wall in walls)
    assert np.hypot(*side.vertices.T[:2]) == pytest.approx(np.full(len(side.vertices), 0.095))
    assert side.vertices[:, 2].max() == pytest.approx(0.1 + 5 * 3e-3)
    radii = np.hypot(*bottom.vertices.T[:2])
    assert (radii.min(), radii.max()) == pytest.approx((0.03, 0.095))
    a, b, c = (bottom.vertices[bottom.triangles[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert area == pytest.approx(np.pi * (0.095**2 - 0.03**2), rel=1e-3)
    assert (walls[0].spin, len(side.outlines), walls[0].spokes) == (0, 2, ())
    assert walls[1].spin == pytest.approx(0.5 * np.pi)


def test_a_part_that_moves_is_drawn_where_it_is_in_each_frame(synthetic, tmp_path):
    motion = PartMotion(
        velocity=(0.01, 0.0, 0.02), rotation=PartRotation(axis=(0.0, 1.0, 0.2), origin=(0.0, 0.0, 0.01), rate=0.7)
    )
    blade = of_triangles(*sheet(1, 0.02)).model_copy(update={"name": "blade", "moves": motion})
    scene = synthetic.scene().model_copy(update={"container": Primitives(parts=(blade,))})
    run = replace(synthetic.observe(synthetic.scene(), seed=1, recorded=True), scene=scene, tables={})
    columns = {"id": 0, "x": 0.01, "y": 0.02, "z": 0.03, "vx": 0.1, "vy": 0, "vz": 0}
    times = np.array([0.0, 1.5])
    table = {"time": times, **{name: np.full(2, value) for name, value in columns.items()}}
    found = chunks(write([RecordedRun.of(run, table, "a")], tmp_path / "a.rrd", "1" * 16))
    drawn = next(wall for wall in drawn_walls(scene, np.array([[0.01, 0.02, 0.03]])) if wall.name == "blade")
    shifts = column(found["/walls/blade", False], "Transform3D:translation")
    matrices = column(found["/walls/blade", False], "Transform3D:mat3x3")
    there = [mesh.vertices for mesh in drawn.at(times)]
    assert np.abs(there[1] - there[0]).max() > 0.01
    for place, shift, matrix in zip(there, shifts, matrices, strict=True):
        columns_of = np.ravel(matrix).reshape(3, 3)  # as rerun stores them
        assert drawn.mesh.vertices @ columns_of + np.ravel(shift) == pytest.approx(place, abs=1e-7)
