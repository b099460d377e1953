"""Films: their frames, duration and size; what is where in a frame, and in which colour; and their files."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from labbook.backend.numerics import Numerics
from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.export import film as films
from labbook.export.colour_bar import BACKGROUND, speed_colours
from labbook.export.colouring import Colouring, NoColouring
from labbook.export.film import Camera, NoFilm, Shot, film, of_sweep, sweep_film
from labbook.export.frames import Frame
from labbook.measure import RunData
from labbook.scene import (
    Container,
    CylinderSilo,
    HertzMindlin,
    Kind,
    Packing,
    PartMotion,
    PartRotation,
    Scene,
    Spheres,
    Spherocylinders,
    WedgeHopper,
)

D = 3e-3
LAW = HertzMindlin(shear_modulus=5e6, poisson_ratio=0.25, friction=0.5, restitution=0.2)
HOPPER = WedgeHopper(width=0.04, height=0.3, thickness=1.01 * D, angle=math.pi / 2, orifice=0.012)
UPRIGHT, LYING = (1.0, 0.0, 0.0, 0.0), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
BED = [(-0.01, 0.0, 0.01), (0.0, 0.0, 0.03), (0.01, 0.0, 0.01)]


def run_of(
    frames, grains=None, container: Container = HOPPER, outcome="finished", by="layers", crossing=(), q=None, **own
) -> Shot:
    """A run of the grains of `BED` with these frames."""
    x = np.array(BED)
    start = Packing(x=x, v=0 * x, omega=0 * x, q=q, **own)
    grains = grains or Spheres(diameter=D, density=2500, count=len(x))
    scene = Scene(grains=grains, contact=LAW, container=container)
    times = np.array(crossing, float)
    table = {"time": times, "id": np.arange(len(times))}
    data = RunData(scene, Numerics(dt=1e-5), 1, start, outcome, frames[-1].time, {"crossing": table})
    return Shot(data, frames, Colouring.of(by, scene, start, frames), "a run")


def frame(time=0.0, x=BED, speed=0.0, ids=None, q=None) -> Frame:
    x = np.array(x, np.float32).reshape(-1, 3)
    turns = None if q is None else np.array(q, np.float32)
    v = np.full((len(x), 3), (0.0, 0.0, -speed))
    return Frame(time, x, v, np.arange(len(x)) if ids is None else np.array(ids), turns)


def colour_at(camera: Camera, seen: np.ndarray, x: float, z: float) -> np.ndarray:
    """RGB of the pixel at a place [m]."""
    view = camera.view
    return seen[int((view.z - z) * view.scale + view.down / 2), int((x - view.x) * view.scale + view.across / 2)]


def hue(colour) -> np.ndarray:
    """Direction of a colour, whatever its brightness."""
    return np.asarray(colour, float) / np.linalg.norm(np.asarray(colour, float))


def test_grains_have_the_colours_of_their_speeds():
    """The middle of a grain is lit from the front: its hue is that of the colour map, brightness aside."""
    speeds = np.array([0.0, 0.3, 1.0])
    here = frame()._replace(v=np.outer(speeds, (0, 0, -1)))
    many = [here, *(here._replace(time=0.1 * k) for k in range(1, 3))]
    camera = Camera(run_of(many, by="speed"), 300)
    seen = camera.pixels(here)
    for (x, _, z), colour in zip(BED, speed_colours(speeds, camera.shot.colouring.top), strict=True):
        assert hue(colour_at(camera, seen, x, z)) @ hue(colour[:3]) > 0.99


def test_upright_rods_are_blue_and_lying_ones_orange():
    rods = Spherocylinders(diameter=D, length=3 * D, density=600, count=3)
    q = [UPRIGHT, LYING, UPRIGHT]
    camera = Camera(run_of([frame(q=q)], rods, by="orientation", q=np.array(q)), 300)
    seen = camera.pixels(camera.shot.frames[0])
    colours = [colour_at(camera, seen, x, z).astype(int) for x, _, z in BED]
    assert [bool(colour[2] > colour[0] + 40) for colour in colours] == [True, False, True]
    assert colours[1][0] > colours[1][2] + 40


def test_each_kind_has_its_colour():
    kinds = tuple(Kind(name=name, share=share) for name, share in (("a", 0.6), ("b", 0.4)))
    grains = Spheres(diameter=D, density=2500, count=3, kinds=kinds)
    shot = run_of([frame()], grains, by="species", kind=np.array([0, 1, 0]), diameter=np.full(3, D))
    first, second, third = shot.colouring.of_frame(shot.frames[0])
    assert (first == third).all()
    assert (first != second).any()
    legend = shot.colouring.legend()
    assert legend is not None
    assert [label for _, label in legend.ticks] == ["a", "b"]
    assert (legend.colours == [first, second]).all()


def test_colours_that_a_scene_has_not_are_refused():
    scene = run_of([frame()]).data.scene
    start = run_of([frame()]).data.start
    for by, remedy in (("orientation", "layers"), ("species", "layers"), ("mood", "use one of")):
        with pytest.raises(NoColouring, match=remedy):
            Colouring.of(by, scene, start, [frame()])


@pytest.mark.parametrize("ending", [".webp", ".gif"])
def test_a_film_has_the_frames_the_duration_and_the_size_that_were_asked_for(tmp_path, ending):
    """Ten recorded frames make a film of ten; durations are whole milliseconds, of GIF hundredths of a second."""
    shot = run_of([frame(0.1 * k, np.array(BED) - [0, 0, 1e-3 * k]) for k in range(10)], crossing=(0.2, 0.5, 0.8))
    written = film(shot, tmp_path / f"a{ending}", seconds=2.0, size=80)
    image: Any = Image.open(written.path)
    assert (image.n_frames, written.frames, image.size) == (10, 10, written.pixels)
    durations = []
    for k in range(10):
        image.seek(k)
        image.load()
        durations.append(image.info["duration"])
    assert sum(durations) == pytest.approx(2000, abs=1)
    assert max(Camera(shot, 80).at(0).size) <= 80
    assert film(shot, tmp_path / f"b{ending}", seconds=0.2, size=60).frames == 5  # 25 frames a second at most
    with pytest.raises(NoFilm, match="above 0"):
        film(shot, tmp_path / "c.gif", seconds=0)


def test_a_frame_shows_the_grains_of_its_time():
    shot = run_of([frame(0.1 * k, [(-0.01 + 0.002 * k, 0, 0.02)]) for k in range(10)])
    camera = Camera(shot, 200)
    for time, x in ((0.0, -0.01), (0.5, 0.0), (0.59, 0.0), (5.0, 0.008)):
        covered = (np.asarray(camera.at(time)) != BACKGROUND).any(axis=2)
        view = camera.view
        inside = covered[: int(view.down / 2 + (view.z - 0.005) * view.scale), 6:-6]  # without walls
        columns = np.flatnonzero(inside.any(axis=0)) + 6.5
        assert (columns.mean() - view.across / 2) / view.scale + view.x == pytest.approx(x, abs=1 / view.scale)


def test_a_film_of_a_clogged_run_ends_soon_after_its_last_grain():
    frames = [frame(0.01 * k) for k in range(400)]
    for outcome, end in (("clogged", 1.0), ("finished", 3.99)):
        shot = run_of(frames, outcome=outcome, crossing=(0.1, 0.8))
        assert shot.end == pytest.approx(end)


def test_a_sweep_has_its_keys_as_headings_and_each_run_in_its_place(monkeypatch, tmp_path):
    places = {}
    monkeypatch.setattr(films, "sweep_film", lambda *given, **more: places.update(given=given))
    angles, orifices = (math.radians(40), math.radians(90)), (0.018, 0.024, 0.03)
    shots = [
        ({"container.angle": angle, "container.orifice": orifice}, f"{angle:.2f} {orifice}")
        for orifice in reversed(orifices)
        for angle in angles
    ]
    of_sweep(shots, tmp_path / "a.webp")  # pyright: ignore[reportArgumentType]
    rows, columns, found, _ = places["given"]
    assert list(rows) == ["angle = 40 deg", "angle = 90 deg"]
    assert list(columns) == ["D = 18 mm", "D = 24 mm", "D = 30 mm"]
    for row, angle in enumerate(angles):
        for column, orifice in enumerate(orifices):
            assert found[row, column] == f"{angle:.2f} {orifice}"


def test_each_run_of_a_sweep_is_drawn_in_its_row_and_column(tmp_path):
    """One of four runs has a red grain in it: of the four parts of the picture, the one at its place alone is red."""
    rods = Spherocylinders(diameter=D, length=3 * D, density=600, count=3)
    upright, lying = (
        run_of([frame(q=[q] * 3)], rods, by="orientation", q=np.array([q] * 3)) for q in (UPRIGHT, LYING)
    )  # fmt: skip
    shots = {(0, 0): upright, (0, 1): upright, (1, 0): lying, (1, 1): upright}
    written = sweep_film(["", ""], ["", ""], shots, tmp_path / "a.webp", size=80)
    seen = np.asarray(Image.open(written.path).convert("RGB")).astype(int)
    orange = seen[..., 0] - seen[..., 2] > 80
    legend = orange[-40:].copy()
    orange[-40:] = False
    middle = seen.shape[1] // 2
    rows = np.flatnonzero(orange.any(axis=1))
    assert orange[:, :middle].any()
    assert not orange[:, middle:].any()
    assert rows.min() > (seen.shape[0] - 40) / 2 - 20
    assert legend.any()


def test_a_moving_part_is_drawn_where_it_is():
    """A sheet that rises: its lines rise with it, and those of the hopper stay."""
    motion = PartMotion(velocity=(0.0, 0.0, 0.02), rotation=PartRotation(axis=(0.0, 1.0, 0.0), rate=0.5))
    blade = of_triangles(*sheet(3, 0.02)).model_copy(update={"name": "blade", "moves": motion})
    container = HOPPER.model_copy(update={"parts": (blade,)})
    camera = Camera(run_of([frame()], container=container), 100)
    still = HOPPER.section()
    assert tuple(camera._walls(0.0)[: len(still)]) == still
    first, later = (np.array(camera._walls(time)[len(still) :]) for time in (0.0, 1.0))
    angle = 0.5  # about the y axis: x' = x cos + z sin, z' = z cos - x sin
    x = first[..., 0] * math.cos(angle) + first[..., 1] * math.sin(angle)
    z = first[..., 1] * math.cos(angle) - first[..., 0] * math.sin(angle) + 0.02
    assert len(first)
    assert later == pytest.approx(np.stack([x, z], axis=-1), abs=1e-9)


def test_a_part_that_vanishes_is_drawn_until_then():
    gate = of_triangles(*sheet(3, 0.02)).model_copy(update={"name": "gate", "opens": 0.2})
    container = HOPPER.model_copy(update={"parts": (gate,)})
    camera, still = Camera(run_of([frame()], container=container), 100), len(HOPPER.section())
    before, after = (np.array(camera._walls(time)[still:]).reshape(-1, 2, 2) for time in (0.19, 0.21))
    assert np.linalg.norm(before[:, 1] - before[:, 0], axis=1).sum() > 0.01
    assert np.linalg.norm(after[:, 1] - after[:, 0], axis=1).sum() < 1e-9


@pytest.mark.parametrize("time", [0.0, 0.13, 0.9])
def test_marks_turn_with_the_bottom(time):
    """Every second of sixteen sectors of the rim is marked, counted from the angle that the bottom has turned by."""
    silo = CylinderSilo(diameter=0.06, height=0.3, orifice=0.02, rotation=0.5)
    rods = Spherocylinders(diameter=D, length=3 * D, density=600, count=3)
    camera = Camera(run_of([frame(q=[UPRIGHT] * 3)], rods, container=silo, q=np.array([UPRIGHT] * 3)), 100)
    (wall,) = camera._turning
    lines = [(sorted((a[0], b[0])), a[1]) for a, b in films._marks(wall, time)]
    assert {z for _, z in lines} == {0.0}
    for angle in np.linspace(0.01, math.pi - 0.01, 301):
        x = 0.03 * math.cos(angle)
        turned = (angle - math.pi * time) % (math.pi / 4)
        if abs(x) > 0.0101 and min(abs(turned - edge) for edge in (0, math.pi / 8, math.pi / 4)) > 1e-3:
            assert any(low <= x <= high for (low, high), _ in lines) == (turned < math.pi / 8), angle


def touching(deep=2e-5) -> tuple[Shot, float]:
    """Two grains that overlap in the last of two frames, and their force [N]; a third one is alone."""
    x = np.array([(-0.005, 0, 0.02), (-0.005 + D - deep, 0, 0.02), (0.01, 0, 0.03)])
    bare = run_of([frame(), frame(0.1, x)])
    frames = {name: np.concatenate([getattr(one, name) for one in bare.frames]) for name in ("ids", "x")}
    table = {"id": frames["ids"], "time": np.repeat([0.0, 0.1], 3), **dict(zip("xyz", frames["x"].T, strict=True))}
    table |= {name: np.zeros(6) for name in ("vx", "vy", "vz")}
    shot = Shot.of(bare.data, table, "force", "a run", "reference")
    return shot, 4 / 3 * LAW.shear_modulus / 0.75 * math.sqrt(D / 4) * deep**1.5  # E* = G/(1 - nu)


def test_forces_of_a_contact_are_those_of_its_law():
    """Places are stored in single precision: 1e-9 m of 2e-5 m of overlap."""
    shot, size = touching()
    assert shot.forces is not None
    assert len(shot.forces(shot.frames[0]).size) == 0
    found = shot.forces(shot.frames[1])
    assert found.size == pytest.approx([size], rel=1e-3)
    assert sorted(found.ends[0, :, 0]) == pytest.approx([-0.005, -0.005 + D - 2e-5], abs=1e-8)
    assert shot.colouring.top == pytest.approx(size, rel=1e-3)


def test_a_contact_force_is_a_dark_line_between_its_grains():
    shot, _ = touching()
    camera = Camera(shot, 300)
    seen = camera.pixels(shot.frames[1]).astype(int)
    places = (-0.0035, 0.02), (-0.0035, 0.0212), (0.01, 0.03)
    inside, beside, alone = (colour_at(camera, seen, *place).sum() for place in places)
    assert inside < 150 < 500 < min(beside, alone)
    legend = shot.colouring.legend()
    assert legend is not None
    weight = 2500 * math.pi / 6 * D**3 * 9.81
    assert legend.ticks[-1][1] == f"≥ {shot.colouring.top / weight:.2g}"


def without_encoder(monkeypatch):
    monkeypatch.setattr(films.shutil, "which", lambda name: None)
    monkeypatch.setattr(films, "find_spec", lambda name: None)


def test_mp4_without_an_encoder_is_refused_with_the_remedy(monkeypatch, tmp_path):
    without_encoder(monkeypatch)
    with pytest.raises(NoFilm, match=r"pip install imageio-ffmpeg, or use \.webp or \.gif"):
        film(run_of([frame()]), tmp_path / "a.mp4")
    with pytest.raises(NoFilm, match=r"\.webp, \.gif, \.mp4"):
        film(run_of([frame()]), tmp_path / "a.avi")
    assert not list(tmp_path.iterdir())


def test_an_encoder_gets_every_pixel_of_every_frame(monkeypatch, tmp_path):
    """In place of ffmpeg a script that keeps what it is given."""
    script = tmp_path / "ffmpeg"
    script.write_text('#!/bin/sh\nfor last; do :; done\necho "$@" > "$last.told"\ncat > "$last"\n')
    script.chmod(0o755)
    monkeypatch.setattr(films.shutil, "which", lambda name: str(script))
    written = film(run_of([frame(0.1 * k) for k in range(4)]), tmp_path / "a.mp4", seconds=1.0, size=50)
    width, height = written.pixels
    assert (width % 2, height % 2) == (0, 0)  # as yuv420p needs them
    assert written.path.stat().st_size == 4 * width * height * 3
    script.write_text("#!/bin/sh\necho no such codec >&2\nexit 1\n")
    with pytest.raises(NoFilm, match="no such codec"):
        film(run_of([frame()]), tmp_path / "b.mp4", size=50)


def test_w_grows_with_the_film(synthetic, tmp_path):
    run = synthetic.observe(synthetic.scene(count=200), seed=1, recorded=True)
    run = replace(run, recorded=lambda: run.tables["sample"])
    shot = Shot.of(run, run.tables["sample"], "layers", "a run", "numba")
    curve = films.flow_curve(run)
    assert curve is not None
    chart = films.FlowChart([films.FlowCurve(*curve)], float(curve[0][-1]), 340, 230)
    blue = [
        int((np.asarray(chart.at(part * curve[0][-1])).astype(int) @ [1, 0, -1] < -15).sum()) for part in (0, 0.5, 1)
    ]
    _, half, whole = (count - blue[0] for count in blue)  # labels are bluish too
    time, rate = curve
    left = np.trapezoid(np.where(time <= time[-1] / 2, rate, 0), time) / np.trapezoid(rate, time)
    assert half / whole == pytest.approx(left, abs=0.02)  # areas below W(t), to the width of its line
    assert shot.end == pytest.approx(run.duration)


def test_labels_of_a_legend_do_not_overlap():
    """A bar of 200 pixels has no room for all of eight labels of 25 to 40 pixels; the first and the last stay."""
    ticks = [(place, f"{place:.3f}") for place in np.sqrt(np.linspace(0, 0.8, 7))] + [(1.0, "≥ 0.69")]
    kept = list(films._spaced_ticks(ticks, 200))
    assert kept[0] == ticks[0]
    assert kept[-1] == ticks[-1]
    assert 2 < len(kept) < len(ticks)
    assert (np.diff([place for place, _ in kept[:-1]]) * 200 > films._extent("0.000", 10)[0] / 2).all()
    assert list(films._spaced_ticks(ticks, 2000)) == ticks
