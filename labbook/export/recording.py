"""Recordings of finished runs for the rerun viewer: grains coloured by speed, walls, and W(t) on the same clock.

Grains of several kinds have a colour a kind, the lighter the faster; a bar below them says which colour is what.

rerun is imported only here and in `labbook.export.viewer`, and only when a recording is made or shown.
"""

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from labbook.export.colour_bar import BACKGROUND, colour_bar, kind_colours, speed_colours
from labbook.export.wall_shapes import drawn_walls, wall_points
from labbook.lab import RunRecord
from labbook.lab.runs import read_recording, run_data
from labbook.measure import RunData
from labbook.measure.series import crossing_times, smooth_flow
from labbook.scene import Bodies, Packing, Scene
from labbook.scene.orientation import axes
from labbook.study import Point

VERSION = 3
"""Raised when recordings made before are no longer what would be written now."""
FRAMES, POSITIONS = 200, 4_000_000
"""Most frames of a recording, or positions of grains in all its frames, whichever are more frames: its size is
16 bytes a position, of rods 32. Of more frames every second, third ... is shown."""
CLOCK = "sim_time"
"""Name of the timeline: seconds since the opening."""
EDGE_COLOUR = (60, 66, 80)
SPOKE_COLOUR = (213, 94, 0)  # of one spoke of a wall that turns: whole turns can be counted by it
FLOW_COLOUR = (86, 180, 233)
_GRAINS_SMOOTHED = 30
_EDGE = 1.2  # points on the screen: half the width of an edge, however large the silo is
_BAR = "colours"
_FIELD_OF_VIEW = math.radians(55)  # vertical, of rerun's eye: it cannot be set, nor can a parallel projection
_NARROWEST = 0.9  # width over height of a view that shows all
_MARGIN = 1.08
_SEEN_FROM = math.radians(12)
Q_COLUMNS = ("qw", "qx", "qy", "qz")


class Frame(NamedTuple):
    """Time [s], positions [n, 3] (single precision), speeds [n] and ids [n] of a frame; orientations [n, 4] of rods."""

    time: float
    x: np.ndarray
    speed: np.ndarray
    ids: np.ndarray
    q: np.ndarray | None = None

    def empty(self, time: float) -> "Frame":
        """Such a frame at another time, without any grain."""
        q = None if self.q is None else self.q[:0]
        return Frame(time, self.x[:0], self.speed[:0], self.ids[:0], q)


class ViewerMissing(Exception):
    """rerun is not installed; the message says how to get it."""


class NotRecorded(Exception):
    """The run kept no frames; the message says how to ask for them."""


def file_name(point: int, seed: int, discharge: int = 1) -> str:
    """Name of a run's files, without their ending: `point-1-seed-1`; `point`: its index, from 0."""
    return f"point-{point + 1}-seed-{seed}" + (f"-discharge-{discharge}" if discharge > 1 else "")


def of_run(folder: Path, lab: Path, study: str | None = None, point: Point | None = None) -> Path:
    """The recording of the finished run in `folder`: lab/recordings/STUDY/point-1-seed-1-BACKEND.rrd.

    It is made if it is not there yet, or if another run's or an older recording has that name. `study`, `point`: as
    which the run is shown; None: as which it was made.
    Raises Unreadable (of labbook.lab), NotRecorded or ViewerMissing.
    """

    record = RunRecord.read(folder)
    name = study or record.study
    index, label = (record.point, record.label) if point is None else (point.index, point.label)
    path = lab / "recordings" / name / f"{file_name(index, record.seed, record.discharge)}-{record.backend}.rrd"
    source = source_of(record)
    if holds(path, source):
        return path
    title = f"{name}: {label}, {record.repeat}"
    return write(run_data(folder, record), read_recording(folder, record), path, name=title, source=source)


def source_of(record: RunRecord) -> str:
    """What a recording of a run is made from: the run, how far it went, and the time between its frames."""
    had = record.coverage
    return f"{record.run_key}-{had.steps}-{had.frame_interval or 0:g}"


def holds(path: Path, source: str) -> bool:
    """Whether `path` is a recording from `source` as it would be written now. Raises ViewerMissing."""
    wanted = recording_id(source)
    if not path.exists():
        return False
    from rerun.chunk import RrdReader

    try:
        return [entry.recording_id for entry in RrdReader(path).recordings()] == [wanted]
    except (RuntimeError, OSError):  # it is no recording, or not all of one: written anew
        return False


def recording_id(source: str) -> str:
    """What a recording from this source calls itself. Only the viewer's own and the next minor version are promised to
    read it, so that the version is a part of it. Raises ViewerMissing."""
    minor = ".".join(need_rerun().__version__.split(".")[:2])
    return f"{source}-{VERSION}-rerun-{minor}"


def write(data: RunData, sample: Mapping[str, np.ndarray] | None, path: Path, *, name: str, source: str) -> Path:
    """Write the recording of one run to `path` (.rrd), in place by one rename. `name` is shown in the viewer; `source`:
    of what it is (`source_of`).

    `sample`: the run's recorded frames, columns id, time, x, y, z, vx, vy, vz as the probe `Film` lists them.
    Raises ViewerMissing, or NotRecorded if there are none.
    """
    late = sample is not None and float(np.min(sample["time"], initial=math.inf)) > 0
    most = max(FRAMES, POSITIONS // data.scene.grains.count)
    shown = frames_of(sample, most - late - (data.outcome == "emptied"))
    if late:
        shown.insert(0, at_opening(data.start, shown[0].q is not None))  # or nothing would be seen at first
    if data.outcome == "emptied" and data.duration > shown[-1].time:
        shown.append(shown[-1].empty(data.duration))  # or the last grains would be seen until the end
    rr = need_rerun()
    fastest = top_speed(data.scene, shown)
    views = front_view(data.scene, shown, name=name)
    with written(path, name, recording_id(source), data.scene, views, _flow_rate_views(data)) as stream:
        log_grains(stream, "", data.scene, data.start, shown, fastest)
        log_bar(stream, data.scene, fastest)
        send_flow_rate(rr, stream, data)
    return path


@contextmanager
def written(path: Path, name: str, identity: str, scene: Scene, grains, below: Sequence = ()) -> Iterator[Any]:
    """A stream of rerun to send to, which then is put in place as `path` (.rrd) by one rename.

    `name` is shown in the viewer, with the view `grains` above the bar of its colours and other views below that;
    `identity`: what the recording calls itself. Raises ViewerMissing.
    """
    rr = need_rerun()
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    path.parent.mkdir(parents=True, exist_ok=True)
    stream = rr.RecordingStream("labbook", recording_id=identity)
    try:
        stream.save(partial, default_blueprint=resting(above_bar(grains, scene, below)))
        stream.send_recording_name(name)
        yield stream
        stream.flush()
        stream.disconnect()
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def log_grains(stream, root: str, scene: Scene, start: Packing, frames: Sequence[Frame], fastest: float) -> None:
    """Send grains, coloured by speed up to `fastest` [m/s], and the walls around them, below the entity `root`.

    `start`: the packing that they began from, which says what each is.
    """
    rr = need_rerun()
    at = f"{root}/" if root else ""
    times = [frame.time for frame in frames]
    clock, counts = rr.TimeColumn(CLOCK, duration=times), [len(frame.x) for frame in frames]
    positions = np.concatenate([frame.x for frame in frames])
    speed, ids = np.concatenate([frame.speed for frame in frames]), np.concatenate([frame.ids for frame in frames])
    bodies, which = Bodies.of(scene.grains, start), start.rows(ids)
    colours = speed_colours(speed, fastest)
    if scene.grains.kinds:
        colours = kind_colours(bodies.kind[which], speed, fastest)
    radius, half = scene.grains.radius, scene.grains.half_length
    if half > 0:
        q = np.concatenate([np.asarray(frame.q) for frame in frames])
        # The viewer draws as many capsules as there are lengths: each rod needs its own in every frame. Equal numbers
        # are packed when they are written, and cost less than a byte a rod.
        stream.log(f"{at}grains", rr.Capsules3D.from_fields(fill_mode="solid"), static=True)
        columns = rr.Capsules3D.columns(
            lengths=np.full(len(q), 2 * half, np.float32),
            radii=np.full(len(q), radius, np.float32),
            translations=positions - half * axes(q),  # a capsule begins at its lower end
            quaternions=q[:, [1, 2, 3, 0]],
            colors=colours,
        )
    elif start.diameter is None:
        stream.log(f"{at}grains", rr.Points3D.from_fields(radii=radius), static=True)
        columns = rr.Points3D.columns(positions=positions, colors=colours)
    else:
        sizes = bodies.radius[which].astype(np.float32)
        columns = rr.Points3D.columns(positions=positions, colors=colours, radii=sizes)
    stream.send_columns(f"{at}grains", [clock], columns.partition(counts))
    edge = rr.components.Radius.ui_points(_EDGE)
    for wall in drawn_walls(scene, positions):
        path, shape = f"{at}walls/{wall.name}", wall.mesh
        mesh = rr.Mesh3D(
            vertex_positions=shape.vertices, triangle_indices=shape.triangles, albedo_factor=wall.colour
        )  # fmt: skip
        stream.log(path, mesh, static=True)
        lines = [*shape.outlines, *wall.spokes]  # seen from the front, a plate is its edge
        colours = [EDGE_COLOUR] * (len(lines) - 1) + [SPOKE_COLOUR if wall.spokes else EDGE_COLOUR]
        if lines:
            stream.log(f"{path}/outline", rr.LineStrips3D(lines, colors=colours, radii=edge), static=True)
        if wall.spin:
            turns = [[0, 0, math.sin(wall.spin * t / 2), math.cos(wall.spin * t / 2)] for t in times]
            stream.send_columns(path, [clock], rr.Transform3D.columns(quaternion=turns))
        if wall.part is not None:
            poses = wall.poses(times)
            columns = rr.Transform3D.columns(translation=poses.shift, mat3x3=poses.turn.reshape(-1, 9))
            stream.send_columns(path, [clock], columns)


def frames_of(table: Mapping[str, np.ndarray] | None, most: int = FRAMES) -> list[Frame]:
    """At most `most` frames of a sample: all, every second, every third ... from the first on. Raises NotRecorded if
    there are none."""
    if table is None or not len(table["time"]):
        raise NotRecorded(
            "this run kept no frames: add `record: {every: 10 ms, replicates: 1}` to its study and run it"
        )
    times, starts = np.unique(table["time"], return_index=True)
    ends = np.append(starts[1:], len(table["time"]))
    frames = []
    for k in range(0, len(times), math.ceil(len(times) / most)):
        rows = slice(starts[k], ends[k])
        x = np.stack([table[c][rows] for c in ("x", "y", "z")], axis=1)
        v = np.stack([table[c][rows] for c in ("vx", "vy", "vz")], axis=1)
        q = np.stack([table[c][rows] for c in Q_COLUMNS], axis=1) if "qw" in table else None
        frames.append(Frame(float(times[k]), x.astype(np.float32), np.linalg.norm(v, axis=1), table["id"][rows], q))
    return frames


def at_opening(start: Packing, oriented: bool) -> Frame:
    """The frame of the packing that a run started from."""
    assert start.ids is not None
    q = start.q.astype(np.float32) if oriented and start.q is not None else None
    return Frame(0.0, start.x.astype(np.float32), np.linalg.norm(start.v, axis=1), start.ids, q)


def top_speed(scene: Scene, frames: Sequence[Frame]) -> float:
    """Speed [m/s] at the upper end of the colours: only one grain in 200 exceeds it.

    It is at least a hundredth of sqrt(g d), so that the last trembling of a bed at rest is not seen as motion.
    """
    rest = 0.01 * math.sqrt(scene.gravity * scene.grains.diameter)
    return max(rest, float(np.quantile(np.concatenate([frame.speed for frame in frames]), 0.995)))


def front_view(scene: Scene, frames: Sequence[Frame], *, origin: str = "", name: str):
    """A view from the front of the grains and walls below the entity `origin`, all of them in all `frames`.

    A quasi-2D hopper is seen straight from the front, anything else from a little above.
    """
    import rerun.blueprint as rrb

    eye, middle = seen_from(scene, np.concatenate([frame.x for frame in frames]))
    return rrb.Spatial3DView(
        origin=f"/{origin}",
        contents=["$origin/grains", "$origin/walls/**"],
        name=name,
        eye_controls=rrb.EyeControls3D(
            position=eye,
            look_target=middle,
            eye_up=(0, 0, 1),
        ),
        line_grid=rrb.LineGrid3D(visible=False),
        background=BACKGROUND,
    )


def seen_from(scene: Scene, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the eye is and the point that it looks at [m]: as near as can be with all grains at `positions`, shape
    [n, 3], and the walls around them in view."""
    walls = wall_points(scene, positions)
    reach = scene.grains.radius + scene.grains.half_length
    low = np.minimum(positions.min(axis=0) - reach, walls.min(axis=0, initial=np.inf))
    high = np.maximum(positions.max(axis=0) + reach, walls.max(axis=0, initial=-np.inf))
    middle = (low + high) / 2
    above = 0.0 if scene.container.symmetry == "planar" else _SEEN_FROM
    back = np.array([0, -math.cos(above), math.sin(above)])  # from the middle to the eye
    upward = np.array([0, math.sin(above), math.cos(above)])
    # A point is seen if it is no farther from the line of sight than `half` times its distance from the eye along it.
    half, away = math.tan(_FIELD_OF_VIEW / 2) / _MARGIN, 0.0
    for points, size in ((walls, 0.0), (positions, reach)):
        from_middle = points - middle
        aside = np.maximum(np.abs(from_middle[:, 0]) / _NARROWEST, np.abs(from_middle @ upward)) + size
        away = max(away, float((aside / half + from_middle @ back + size).max(initial=0)))
    return middle + away * back, middle


def log_bar(stream, scene: Scene, fastest: float) -> None:
    """Send the bar that says what colours up to the speed `fastest` [m/s] mean."""
    bar = colour_bar([kind.name for kind in scene.grains.kinds], fastest)
    stream.log(_BAR, need_rerun().EncodedImage(contents=bar, media_type="image/png"), static=True)


def above_bar(grains, scene: Scene, below: Sequence):
    """The view `grains` above the bar of its colours, and other views below that."""
    import rerun.blueprint as rrb

    bar = rrb.Spatial2DView(origin=f"/{_BAR}", name="colours", titlebar=False, background=BACKGROUND)
    rows = max(1, len(scene.grains.kinds))
    return rrb.Vertical(grains, bar, *below, row_shares=[10, 1 + 0.25 * (rows - 1), *(2 for _ in below)])


def resting(views):
    """A blueprint of `views` in which playback rests at the start, and nothing else is shown."""
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        views,
        rrb.TimePanel(timeline=CLOCK, play_state="paused", state="collapsed"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def _flow_rate_views(data: RunData) -> list:
    """W(t), if grains have left."""
    import rerun.blueprint as rrb

    if not _flows(data):
        return []
    return [rrb.TimeSeriesView(origin="/flow_rate", name="W [g/s]", plot_legend=rrb.PlotLegend(visible=False))]


def _flows(data: RunData) -> bool:
    return "crossing" in data.tables and len(crossing_times(data)) >= 2


def send_flow_rate(rr, stream, data: RunData) -> None:
    """W(t), smoothed over about 30 grains, as scalars on the clock of the grains."""
    if not _flows(data):
        return
    times = crossing_times(data)
    at = np.linspace(0, data.duration, 500)
    width = _GRAINS_SMOOTHED / math.sqrt(2 * math.pi) * (times[-1] - times[0]) / (len(times) - 1)
    rate = smooth_flow(data, at, width) * 1e3
    stream.log("flow_rate", rr.SeriesLines(colors=FLOW_COLOUR, widths=1.5, names="W [g/s]"), static=True)
    stream.send_columns("flow_rate", [rr.TimeColumn(CLOCK, duration=at)], rr.Scalars.columns(scalars=rate))


def need_rerun():
    """The rerun package. Raises ViewerMissing."""
    try:
        import rerun
    except ImportError as error:
        raise ViewerMissing(f"recordings need rerun ({error}); try: pip install 'labbook[viewer]'") from error
    return rerun
