"""Recordings of finished runs for the rerun viewer: grains coloured by speed, walls, and W(t) on the same clock.

Grains of several kinds have a colour a kind, the lighter the faster.

rerun is imported only here and in `labbook.viewer`, and only when a recording is made or shown.
"""

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labbook.measure import RunData
from labbook.measure.series import crossing_times, smooth_flow
from labbook.protocol import Bodies, Packing
from labbook.protocol.segments import axes
from labbook.scene import Scene
from labbook.wall_shapes import WALL_COLOUR, round_walls, wall_quads

VERSION = 1
"""Raised when recordings made before are no longer what would be written now."""
FRAMES = 200
"""Most frames of a recording: its size is frames x grains x 16 bytes."""
CLOCK = "sim_time"
"""Name of the timeline: seconds since the opening."""
EDGE_COLOUR = (60, 66, 80)
FLOW_COLOUR = (86, 180, 233)
_GRAINS_SMOOTHED = 30
Q_COLUMNS = ("qw", "qx", "qy", "qz")

KIND_COLOURS = np.array([(230, 159, 0), (0, 114, 178), (0, 158, 115), (204, 121, 167), (213, 94, 0), (86, 180, 233)])
"""Okabe and Ito's, which people of all kinds of sight can tell apart."""


class Frame(NamedTuple):
    """Time [s], positions [n, 3] (single precision), speeds [n] and ids [n] of a frame; orientations [n, 4] of rods."""

    time: float
    x: np.ndarray
    speed: np.ndarray
    ids: np.ndarray
    q: np.ndarray | None = None


class ViewerMissing(Exception):
    """rerun is not installed; the message says how to get it."""


class NotRecorded(Exception):
    """The run kept no frames; the message says how to ask for them."""


def of_run(folder: Path, lab: Path) -> Path:
    """The recording of the finished run in `folder`, in `lab`/recordings; made if it is not there yet.

    Raises Unreadable (of labbook.catalogue), NotRecorded or ViewerMissing.
    """
    from labbook.catalogue import RunRecord
    from labbook.catalogue.finished import read_recording, run_data

    # Only the viewer's own and the next minor version are promised to read a recording.
    minor = ".".join(need_rerun().__version__.split(".")[:2])
    record = RunRecord.read(folder)
    path = lab / "recordings" / f"{record.run_key}-{VERSION}-rerun-{minor}.rrd"
    if path.exists():
        return path
    sample = read_recording(folder, record)
    name = f"{record.study}: {record.label}, seed {record.seed}"
    return write(run_data(folder, record), sample, path, name=name, run_key=record.run_key)


def write(data: RunData, sample: Mapping[str, np.ndarray] | None, path: Path, *, name: str, run_key: str) -> Path:
    """Write the recording of one run to `path` (.rrd), in place by one rename. `name` is shown in the viewer.

    `sample`: the run's recorded frames, columns id, time, x, y, z, vx, vy, vz as `labbook.probes.Sample` lists them.
    Raises ViewerMissing, or NotRecorded if there are none.
    """
    shown = frames_of(sample)
    rr = need_rerun()
    fastest = top_speed(shown)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    path.parent.mkdir(parents=True, exist_ok=True)
    stream = rr.RecordingStream("labbook", recording_id=run_key)
    try:
        stream.save(partial, default_blueprint=_blueprint(data, fastest))
        stream.send_recording_name(name)
        log_grains(stream, "", data.scene, data.start, shown, fastest)
        _send_flow_rate(rr, stream, data)
        stream.flush()
        stream.disconnect()
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
    return path


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
        stream.log(f"{at}grains", rr.Capsules3D.from_fields(lengths=[2 * half], radii=[radius]), static=True)
        columns = rr.Capsules3D.columns(
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
    for wall, corners, colour in wall_quads(scene, positions):
        mesh = rr.Mesh3D(vertex_positions=corners, triangle_indices=[[0, 1, 2], [0, 2, 3]], albedo_factor=colour)
        stream.log(f"{at}walls/{wall}", mesh, static=True)
        if colour == WALL_COLOUR:  # seen from the front, a plate is its edge
            outline = rr.LineStrips3D([[*corners, corners[0]]], colors=EDGE_COLOUR, radii=radius / 8)
            stream.log(f"{at}walls/{wall}/outline", outline, static=True)
    for wall in round_walls(scene, positions):
        path = f"{at}walls/{wall.name}"
        mesh = rr.Mesh3D(
            vertex_positions=wall.vertices, triangle_indices=wall.triangles, albedo_factor=wall.colour
        )  # fmt: skip
        stream.log(path, mesh, static=True)
        stream.log(f"{path}/outline", rr.LineStrips3D(wall.lines, colors=EDGE_COLOUR, radii=radius / 8), static=True)
        if wall.spin:
            turns = [[0, 0, math.sin(wall.spin * t / 2), math.cos(wall.spin * t / 2)] for t in times]
            stream.send_columns(path, [clock], rr.Transform3D.columns(quaternion=turns))


def speed_colours(speed: np.ndarray, top_speed: float) -> np.ndarray:
    """RGBA bytes, shape [n, 4], of `speed` [m/s] on a square-root scale from 0 (dark) to `top_speed` (yellow).

    The square root keeps slow zones, at a few per cent of the outlet's speed, apart from those at rest.
    """
    from matplotlib import colormaps

    part = np.sqrt(np.clip(speed / top_speed, 0, 1)) if top_speed > 0 else np.zeros_like(speed)
    return colormaps["viridis"](part, bytes=True)


def kind_colours(kind: np.ndarray, speed: np.ndarray, top_speed: float) -> np.ndarray:
    """RGBA bytes, shape [n, 4]: a colour a kind (places, shape [n]), two thirds white at `top_speed` [m/s] and beyond.

    Speeds count by their square roots, as in `speed_colours`.
    """
    part = np.sqrt(np.clip(speed / top_speed, 0, 1)) if top_speed > 0 else np.zeros(len(kind))
    plain = KIND_COLOURS[kind % len(KIND_COLOURS)]
    mixed = plain + (255 - plain) * (part * 2 / 3)[:, None]
    return np.column_stack([mixed, np.full(len(kind), 255)]).astype(np.uint8)


def frames_of(table: Mapping[str, np.ndarray] | None) -> list[Frame]:
    """At most FRAMES frames of a sample, evenly chosen. Raises NotRecorded if there are none."""
    if table is None or not len(table["time"]):
        raise NotRecorded(
            "this run kept no frames: add `record: {every: 10 ms, replicates: 1}` to its study and run it"
        )
    times, starts = np.unique(table["time"], return_index=True)
    ends = np.append(starts[1:], len(table["time"]))
    chosen = np.unique(np.linspace(0, len(times) - 1, min(FRAMES, len(times))).round().astype(int))
    frames = []
    for k in chosen:
        rows = slice(starts[k], ends[k])
        x = np.stack([table[c][rows] for c in ("x", "y", "z")], axis=1)
        v = np.stack([table[c][rows] for c in ("vx", "vy", "vz")], axis=1)
        q = np.stack([table[c][rows] for c in Q_COLUMNS], axis=1) if "qw" in table else None
        frames.append(Frame(float(times[k]), x.astype(np.float32), np.linalg.norm(v, axis=1), table["id"][rows], q))
    return frames


def top_speed(frames: Sequence[Frame]) -> float:
    """Speed [m/s] that only one grain in 200 exceeds."""
    return float(np.quantile(np.concatenate([frame.speed for frame in frames]), 0.995))


def front_view(scene: Scene, x: np.ndarray, fastest: float, *, origin: str = "/", name: str = ""):
    """A view from the front of what lies below `origin`: grains at `x` [m], shape [n, 3], at first."""
    import rerun.blueprint as rrb

    low, high = x.min(axis=0), x.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    return rrb.Spatial3DView(
        origin=origin,
        name=f"{name or 'Grains'}{_legend(scene)} {fastest:.2g} m/s and more (square-root scale)",
        eye_controls=rrb.EyeControls3D(
            position=middle + size * np.array([0.06, -1.05, 0.12]), look_target=middle, eye_up=(0, 0, 1)
        ),
        line_grid=rrb.LineGrid3D(visible=False),
        background=(244, 245, 247),
    )


def _legend(scene: Scene) -> str:
    """What colours mean, up to the top speed."""
    names = ("orange", "blue", "green", "pink", "red", "sky blue")
    kinds = scene.grains.kinds
    which = ", ".join(f"{kind.name} {names[k % len(names)]}" for k, kind in enumerate(kinds))
    return f" by kind and speed: {which}; light at" if kinds else " by speed: dark 0, yellow"


def resting(views):
    """A blueprint of `views` in which playback rests at the start, and nothing else is shown."""
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        views,
        rrb.TimePanel(timeline=CLOCK, play_state="paused", state="collapsed"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def _blueprint(data: RunData, fastest: float):
    """The silo seen from the front, W(t) below it."""
    import rerun.blueprint as rrb

    grains = front_view(data.scene, data.start.x, fastest)
    flow = rrb.TimeSeriesView(origin="flow_rate", name="W [g/s]", plot_legend=rrb.PlotLegend(visible=False))
    return resting(rrb.Vertical(grains, flow, row_shares=[4, 1]))


def _send_flow_rate(rr, stream, data: RunData) -> None:
    """W(t), smoothed over about 30 grains, as scalars on the clock of the grains."""
    if "crossing" not in data.tables or len(times := crossing_times(data)) < 2:
        return
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
