"""Recordings of finished runs for the rerun viewer: grains, walls, contact forces, and W(t) on the same clock.

Tabs show the same grains by layers, by speed, by orientation, and with contact forces. By speed, grains of several
kinds have a colour a kind, the lighter the faster; a bar below them says which colour is what.

rerun is imported only here and in `labbook.export.viewer`, and only when a recording is made or shown.
"""

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from labbook.export.colour_bar import BACKGROUND, colour_bar, kind_colours, speed_colours
from labbook.export.colouring import PALE, force_colours, tilt_colours
from labbook.export.forces import PairForces, forces_of, scale_of
from labbook.export.frames import FRAMES, Frame, frames_of_run, top_speed
from labbook.export.wall_shapes import drawn_walls, wall_points
from labbook.lab import RunRecord
from labbook.lab.runs import read_recording, run_data
from labbook.measure import RunData
from labbook.measure.series import flow_curve
from labbook.picture import layer_colours
from labbook.scene import Bodies, Packing, Scene
from labbook.scene.orientation import axes
from labbook.study import Point

VERSION = 5
"""Raised when recordings made before are no longer what would be written now."""
POSITIONS = 4_000_000
"""Most positions of grains in all frames of a recording, if these are more than FRAMES frames: its size is up to 20
bytes a position, of rods 40, without forces. Of more frames every second, third ... is shown."""
FORCES = 400_000
"""Most places of grains in all frames of a recording with contact forces: computing them takes some ten seconds."""
CLOCK = "sim_time"
"""Name of the timeline: seconds since the opening."""
EDGE_COLOUR = (60, 66, 80)
SPOKE_COLOUR = (213, 94, 0)  # of one spoke of a wall that turns: whole turns can be counted by it
FLOW_COLOUR = (86, 180, 233)
_EDGE = 1.2  # points on the screen: half the width of an edge, however large the silo is
_BAR = "colours"
_LASTS = 6.0  # s: duration of playback
_WIDEST, _THINNEST = 0.2, 0.05  # of lines of forces: largest radius in diameters, and least one in parts of that
_SMALL = 0.3  # of grains beside lines of forces: radius in parts of their own
_FIELD_OF_VIEW = math.radians(55)  # vertical, of rerun's eye: it cannot be set, nor can a parallel projection
_NARROWEST = 0.9  # width over height of a view that shows all
_MARGIN = 1.08
_SEEN_FROM = math.radians(12)


class ViewerMissing(Exception):
    """rerun is not installed; the message says how to get it."""


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
    path = path_of(lab / "recordings", record, study, point, ".rrd")
    source = source_of(record)
    if holds(path, source):
        return path
    title = titled(record, study, point)
    data, sample = run_data(folder, record), read_recording(folder, record)
    return write(data, sample, path, name=title, source=source, forces=forces_of(record.backend, data))


def path_of(folder: Path, record: RunRecord, study: str | None, point: Point | None, ending: str) -> Path:
    """File for a recording or a film of a run: FOLDER/STUDY/point-1-seed-1-BACKEND and an ending. study, point: for
    which the run is shown; None: for which it was made."""
    index = record.point if point is None else point.index
    name = f"{file_name(index, record.seed, record.discharge)}-{record.backend}{ending}"
    return folder / (study or record.study) / name


def titled(record: RunRecord, study: str | None = None, point: Point | None = None) -> str:
    """Title of a run, `rods: rotation 0.5 Hz, seed 1`; study, point: as of `path_of`."""
    at, label = (record.at, record.label) if point is None else (point.at, point.label)
    return f"{study or record.study}: {f'{label}, ' if at else ''}{record.repeat}"


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


def write(
    data: RunData,
    sample: Mapping[str, np.ndarray] | None,
    path: Path,
    *,
    name: str,
    source: str,
    forces: Callable[[Frame], PairForces] | None = None,
    opens: str = "layers",
) -> Path:
    """Write the recording of one run to `path` (.rrd), in place by one rename. `name` is shown in the viewer; `source`:
    of what it is (`source_of`); `opens`: name of the tab in front.

    `sample`: the run's recorded frames, columns id, time, x, y, z, vx, vy, vz as the probe `Film` lists them. forces:
    contact forces in a frame, which are sent of runs with at most FORCES places of grains; None: none are.
    Raises ViewerMissing, or NotRecorded if there are none.
    """
    shown = frames_of_run(data, sample, max(FRAMES, POSITIONS // data.scene.grains.count))
    rr = need_rerun()
    import rerun.blueprint as rrb

    fastest = top_speed(data.scene, shown)
    if sum(len(frame.ids) for frame in shown) > FORCES:
        forces = None
    tabs: dict[str, Any] = {"layers": front_view(data.scene, shown, name="layers")}
    tabs["speed"] = above_bar(front_view(data.scene, shown, name="speed", by="speed"), data.scene, name="speed")
    if data.scene.grains.half_length > 0:
        tabs["orientation"] = front_view(data.scene, shown, name="orientation", by="orientation")
    if forces is not None:
        tabs["forces"] = front_view(data.scene, shown, name="forces", by=None)
    below = _flow_rate_views(data)
    front = rrb.Tabs(*tabs.values(), active_tab=[*tabs].index(opens), name=name)
    layout = rrb.Vertical(front, *below, row_shares=[11, *(2 for _ in below)])
    with written(path, name, recording_id(source), layout, data.duration) as stream:
        log_grains(stream, "", data.scene, data.start, shown, fastest)
        log_bar(stream, data.scene, fastest)
        send_flow_rate(rr, stream, data)
        if forces is not None:
            send_forces(rr, stream, [frame.time for frame in shown], [forces(frame) for frame in shown], data.scene)
    return path


def send_forces(rr, stream, times: Sequence[float], forces: Sequence[PairForces], scene: Scene) -> None:
    """Send contact forces as lines between centres, wider and darker the larger the force, at times [s]."""
    top, widest = scale_of(forces), _WIDEST * scene.grains.diameter
    part = np.minimum(np.concatenate([frame.size for frame in forces]) / top, 1.0)
    ends = np.concatenate([frame.ends for frame in forces]).astype(np.float32)
    columns = rr.LineStrips3D.columns(
        strips=ends, radii=(widest * np.maximum(part, _THINNEST)).astype(np.float32), colors=force_colours(part)
    )
    counts = [len(frame.size) for frame in forces]
    stream.send_columns("forces", [rr.TimeColumn(CLOCK, duration=times)], columns.partition(counts))


@contextmanager
def written(path: Path, name: str, identity: str, layout, duration: float) -> Iterator[Any]:
    """Open a stream of rerun to send to, which then is put in place as `path` (.rrd) by one rename.

    `name` is shown in the viewer, with the views of `layout`; `identity`: what the recording calls itself; duration: of
    the run [s]. Raises ViewerMissing.
    """
    rr = need_rerun()
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    path.parent.mkdir(parents=True, exist_ok=True)
    stream = rr.RecordingStream("labbook", recording_id=identity)
    try:
        stream.save(partial, default_blueprint=playing(layout, duration))
        stream.send_recording_name(name)
        yield stream
        stream.flush()
        stream.disconnect()
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def log_grains(stream, root: str, scene: Scene, start: Packing, frames: Sequence[Frame], fastest: float) -> None:
    """Send grains and the walls around them, below the entity `root`.

    Grains have the colours of their layers, and beside them those of speeds up to `fastest` [m/s] and of orientations,
    which views choose (`front_view`). `start`: the packing that they began from, which says what each is.
    """
    rr = need_rerun()
    at = f"{root}/" if root else ""
    times = [frame.time for frame in frames]
    clock, counts = rr.TimeColumn(CLOCK, duration=times), [len(frame.x) for frame in frames]
    positions = np.concatenate([frame.x for frame in frames])
    speed, ids = np.concatenate([frame.speed for frame in frames]), np.concatenate([frame.ids for frame in frames])
    bodies, which = Bodies.of(scene.grains, start), start.rows(ids)
    by_speed = speed_colours(speed, fastest)
    if scene.grains.kinds:
        by_speed = kind_colours(bodies.kind[which], speed, fastest)
    colours = np.rint(255 * layer_colours(scene, start, which)).astype(np.uint8)
    variants = {"speed": by_speed[:, :3]}
    radius, half = scene.grains.radius, scene.grains.half_length
    if half > 0:
        q = np.concatenate([np.asarray(frame.q) for frame in frames])
        variants["orientation"] = tilt_colours(np.abs(axes(q)[:, 2]))
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
    sent = [*columns.partition(counts)]
    for by, of_grains in variants.items():
        packed = {"colors": rr.components.ColorBatch(of_grains)}
        sent += rr.DynamicArchetype.columns(archetype=by, components=packed).partition(counts)
    stream.send_columns(f"{at}grains", [clock], sent)
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


def front_view(
    scene: Scene, frames: Sequence[Frame], *, origin: str = "", name: str, by: str | None = "layers"
):  # fmt: skip
    """A view from the front of the grains and walls below the entity `origin`, all of them in all `frames`.

    by: what grains are coloured by, `layers`, `speed` or `orientation`; None: they are small and pale beside the lines
    of contact forces.

    A quasi-2D hopper is seen straight from the front, anything else from a little above.
    """
    rr = need_rerun()
    import rerun.blueprint as rrb
    from rerun.blueprint.encodings import VisualizerComponentMapping

    rods = scene.grains.half_length > 0
    shape = rr.Capsules3D if rods else rr.Points3D
    overrides: dict[Any, Any] = {}
    if by is None:
        small = _SMALL * scene.grains.radius
        overrides = {f"{origin and f'/{origin}'}/grains": shape.from_fields(colors=[PALE], radii=[small])}
    elif by != "layers":
        source = VisualizerComponentMapping(
            f"{shape.__name__}:colors", "SourceComponent", source_component=f"{by}:colors"
        )
        overrides = {f"{origin and f'/{origin}'}/grains": shape.from_fields().visualizer(mappings=[source])}
    eye, middle = seen_from(scene, np.concatenate([frame.x for frame in frames]))
    return rrb.Spatial3DView(
        origin=f"/{origin}",
        contents=["$origin/grains", "$origin/walls/**", *(["$origin/forces"] if by is None else [])],
        name=name,
        overrides=overrides,
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


def above_bar(grains, scene: Scene, name: str):
    """The view `grains` above the bar of its colours."""
    import rerun.blueprint as rrb

    bar = rrb.Spatial2DView(origin=f"/{_BAR}", name="colours", titlebar=False, background=BACKGROUND)
    rows = max(1, len(scene.grains.kinds))
    return rrb.Vertical(grains, bar, row_shares=[10, 1 + 0.25 * (rows - 1)], name=name)


def playing(views, duration: float):
    """A blueprint of `views` alone, which plays a run of this duration [s] in _LASTS seconds, again and again."""
    import rerun.blueprint as rrb

    speed = duration / _LASTS if duration > 0 else 1.0
    return rrb.Blueprint(
        views,
        rrb.TimePanel(timeline=CLOCK, play_state="playing", loop_mode="all", playback_speed=speed, state="collapsed"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def _flow_rate_views(data: RunData) -> list:
    """W(t), if grains have left."""
    import rerun.blueprint as rrb

    if flow_curve(data) is None:
        return []
    legend, plot = rrb.PlotLegend(visible=False), rrb.archetypes.PlotBackground(color=BACKGROUND)
    return [rrb.TimeSeriesView(origin="/flow_rate", name="W [g/s]", plot_legend=legend, background=plot)]


def send_flow_rate(rr, stream, data: RunData) -> None:
    """W(t), smoothed over about 30 grains, as scalars on the clock of the grains."""
    if (curve := flow_curve(data)) is None:
        return
    at, rate = curve
    stream.log("flow_rate", rr.SeriesLines(colors=FLOW_COLOUR, widths=1.5, names="W [g/s]"), static=True)
    stream.send_columns("flow_rate", [rr.TimeColumn(CLOCK, duration=at)], rr.Scalars.columns(scalars=rate))


def need_rerun():
    """The rerun package. Raises ViewerMissing."""
    try:
        import rerun
    except ImportError as error:
        raise ViewerMissing(f"recordings need rerun ({error}); try: pip install 'labbook[viewer]'") from error
    return rerun
