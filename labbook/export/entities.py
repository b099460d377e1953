"""Entities of recordings, all on one clock: grains, walls, contact forces, velocities, paths, mean flow, and W(t).

rerun is imported only where a recording is made or shown.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from labbook.export.colour_bar import kind_colours, speed_colours
from labbook.export.colouring import force_colours, tilt_colours
from labbook.export.flow_chart import COLOURS
from labbook.export.forces import PairForces, scale_of
from labbook.export.frames import Frame
from labbook.export.wall_shapes import drawn_walls
from labbook.fields.grids import Ring
from labbook.measure.recorded import Bed
from labbook.picture import layer_colours
from labbook.results.display import with_error
from labbook.scene import Bodies, Clumps, Grains, Packing, Scene, Spherocylinders
from labbook.scene.hulls import sphere_centres
from labbook.scene.orientation import axes

CLOCK = "sim_time"
"""Name of the timeline: seconds since the opening."""
EDGE_COLOUR = (60, 66, 80)
SPOKE_COLOUR = (213, 94, 0)  # of one spoke of a wall that turns: whole turns can be counted by it
_EDGE = 1.2  # points on the screen: half the width of an edge, however large the silo is
_WIDEST, _THINNEST = 0.2, 0.05  # of lines of forces: largest radius in diameters, and least one in parts of that
_ARROWS = 200_000  # in all frames: of larger beds every second, third ... grain has one
_ARROW, _SHAFT = 4.0, 0.11  # length at the upper end of the speeds, and radius, in diameters
_PATHS, _PATH = 120, 0.08  # grains with a path, and its radius in diameters
_FASTER = 2.0  # a step longer than this times what its speeds allow is no motion: the grain was put back
_BOX, _MEAN = 1.0, 2.0  # points on the screen: half the width of W(t), and of the mean over its window


class ViewerMissing(Exception):
    """rerun is not installed; the message says how to get it."""


class Steady(NamedTuple):
    """Window of a run and the mean over it.

    Attributes:
        begin: Begin of the window [s].
        end: End of the window [s].
        rate: Mean flow rate W [g/s].
        error: Its standard error [g/s].
    """

    begin: float
    end: float
    rate: float
    error: float

    @property
    def mean(self) -> str:
        """Mean with its error, as text."""
        return f"{with_error(self.rate, self.error)} g/s"


def need_rerun():
    """Import rerun.

    Returns:
        The package.

    Raises:
        ViewerMissing: It is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise ViewerMissing(f"recordings need rerun ({error}); try: pip install 'labbook[viewer]'") from error
    return rerun


def log_grains(stream, root: str, scene: Scene, start: Packing, frames: Sequence[Frame], fastest: float) -> None:
    """Send grains and the walls around them.

    Grains have the colours of their layers, and beside them those of speeds and of orientations, which views choose
    (`labbook.export.views.front_view`).

    Args:
        stream: Stream of rerun.
        root: Entity above grains and walls.
        scene: Scene of the run.
        start: Packing that the run started from, with sizes and kinds of the grains.
        frames: Frames of the run.
        fastest: Speed at the upper end of the colours [m/s].
    """
    rr = need_rerun()
    at = below(root)
    times = [frame.time for frame in frames]
    clock, counts = rr.TimeColumn(CLOCK, duration=times), [len(frame.x) for frame in frames]
    positions = np.concatenate([frame.x for frame in frames])
    speed, ids = np.concatenate([frame.speed for frame in frames]), np.concatenate([frame.ids for frame in frames])
    bodies, rows = Bodies.of(scene.grains, start), start.rows(ids)
    by_speed = speed_colours(speed, fastest)
    if scene.grains.kinds:
        by_speed = kind_colours(bodies.kind[rows], speed, fastest)
    colours = np.rint(255 * layer_colours(scene, start, rows)).astype(np.uint8)
    variants = {"speed": by_speed[:, :3]}
    grains, radius = scene.grains, scene.grains.radius
    q = np.concatenate([np.asarray(frame.q) for frame in frames]) if grains.oriented else np.empty((0, 4))
    if grains.elongated:
        variants["orientation"] = tilt_colours(np.abs(axes(q)[:, 2]))
    if is_drawn_as_capsules(grains):
        half = grains.overhang
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
    elif isinstance(grains, Clumps):  # every grain is as many points as it has spheres
        spheres = len(grains.spheres)
        counts, colours = [spheres * count for count in counts], np.repeat(colours, spheres, axis=0)
        variants = {by: np.repeat(of_grains, spheres, axis=0) for by, of_grains in variants.items()}
        sizes = np.tile([sphere.radius for sphere in grains.spheres], len(q)).astype(np.float32)
        columns = rr.Points3D.columns(positions=sphere_centres(grains, positions, q), colors=colours, radii=sizes)
    elif start.diameter is None:
        stream.log(f"{at}grains", rr.Points3D.from_fields(radii=radius), static=True)
        columns = rr.Points3D.columns(positions=positions, colors=colours)
    else:
        sizes = bodies.radius[rows].astype(np.float32)
        columns = rr.Points3D.columns(positions=positions, colors=colours, radii=sizes)
    sent = [*columns.partition(counts)]
    for by, of_grains in variants.items():
        packed = {"colors": rr.components.ColorBatch(of_grains)}
        sent += rr.DynamicArchetype.columns(archetype=by, components=packed).partition(counts)
    stream.send_columns(f"{at}grains", [clock], sent)
    log_walls(stream, root, scene, positions, times)


def is_drawn_as_capsules(grains: Grains) -> bool:
    """True for rods with a length; other grains are spheres to the viewer."""
    return isinstance(grains, Spherocylinders) and not grains.round


def log_walls(stream, root: str, scene: Scene, positions: np.ndarray, times: Sequence[float]) -> None:
    """Send the walls around grains.

    Args:
        stream: Stream of rerun.
        root: Entity above the walls.
        scene: Scene of the run.
        positions: Centres of grains [m], shape [n, 3].
        times: Times of the poses of walls that move [s].
    """
    rr = need_rerun()
    clock, edge = rr.TimeColumn(CLOCK, duration=times), rr.components.Radius.ui_points(_EDGE)
    for wall in drawn_walls(scene, positions):
        path, shape = f"{below(root)}walls/{wall.name}", wall.mesh
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


def send_forces(stream, root: str, times: Sequence[float], forces: Sequence[PairForces], scene: Scene) -> None:
    """Send contact forces as lines between centres, wider and darker the larger the force, at times [s]."""
    rr = need_rerun()
    top, widest = scale_of(forces), _WIDEST * scene.grains.diameter
    fraction = np.minimum(np.concatenate([frame.size for frame in forces]) / top, 1.0)
    ends = np.concatenate([frame.ends for frame in forces]).astype(np.float32)
    columns = rr.LineStrips3D.columns(
        strips=ends, radii=(widest * np.maximum(fraction, _THINNEST)).astype(np.float32), colors=force_colours(fraction)
    )
    counts = [len(frame.size) for frame in forces]
    stream.send_columns(f"{below(root)}forces", [rr.TimeColumn(CLOCK, duration=times)], columns.partition(counts))


def send_velocities(stream, root: str, scene: Scene, frames: Sequence[Frame], fastest: float) -> None:
    """Send velocities as arrows from centres, with the colours of speeds up to `fastest` [m/s]."""
    rr = need_rerun()
    every = math.ceil(sum(len(frame.ids) for frame in frames) / _ARROWS)
    with_arrow = [frame.ids % every == 0 for frame in frames]
    x, v = (
        np.concatenate([getattr(frame, name)[rows] for frame, rows in zip(frames, with_arrow, strict=True)])
        for name in ("x", "v")
    )
    longest = _ARROW * scene.grains.diameter
    columns = rr.Arrows3D.columns(
        origins=x,
        vectors=(v * (longest / fastest)).astype(np.float32),
        colors=speed_colours(np.linalg.norm(v, axis=1), fastest)[:, :3],
    )
    counts = [int(rows.sum()) for rows in with_arrow]
    clock = rr.TimeColumn(CLOCK, duration=[frame.time for frame in frames])
    stream.log(f"{below(root)}velocities", rr.Arrows3D.from_fields(radii=_SHAFT * scene.grains.diameter), static=True)
    stream.send_columns(f"{below(root)}velocities", [clock], columns.partition(counts))


def paths_of(frames: Sequence[Frame], ids: np.ndarray, diameter: float) -> list[tuple[int, np.ndarray]]:
    """Trace the paths of grains from frame to frame.

    A path ends where a grain that had left was put back: there it is farther away than its speeds allow.

    Args:
        frames: Frames of the run.
        ids: Names of the grains.
        diameter: Diameter of a grain [m], the slack of a step.

    Returns:
        Name of the grain and places [m], shape [k, 3], of each path.
    """
    rows = {
        int(grain): [(frame, int(at[0])) for frame in frames if len(at := np.flatnonzero(frame.ids == grain))]
        for grain in ids
    }
    paths = []
    for grain, indices in rows.items():
        if len(indices) < 2:
            continue
        x, v = (np.array([getattr(frame, name)[row] for frame, row in indices], float) for name in ("x", "v"))
        time, speed = np.array([frame.time for frame, _ in indices]), np.linalg.norm(v, axis=1)
        allowed = _FASTER * np.maximum(speed[1:], speed[:-1]) * np.diff(time) + diameter
        breaks = np.flatnonzero(np.linalg.norm(np.diff(x, axis=0), axis=1) > allowed) + 1
        paths += [(grain, piece) for piece in np.split(x, breaks) if len(piece) > 1]
    return paths


def send_paths(stream, root: str, scene: Scene, start: Packing, frames: Sequence[Frame]) -> None:
    """Send the whole paths of some grains of all heights, with the colours of their layers."""
    rr = need_rerun()
    assert start.ids is not None
    order = start.ids[np.argsort(start.x[:, 2], kind="stable")]
    grains = order[np.unique(np.linspace(0, len(order) - 1, min(_PATHS, len(order))).round().astype(int))]
    paths = paths_of(frames, grains, scene.grains.diameter)
    colours = layer_colours(scene, start, start.rows(np.array([grain for grain, _ in paths], int)))
    strips = rr.LineStrips3D(
        [path.astype(np.float32) for _, path in paths],
        colors=np.rint(255 * colours).astype(np.uint8),
        radii=_PATH * scene.grains.diameter,
    )
    stream.log(f"{below(root)}paths", strips, static=True)


def log_mean_flow(stream, root: str, bed: Bed, fastest: float) -> None:
    """Send the mean flow over the window as cells of the plane y = 0, with the colours of speeds up to `fastest`
    [m/s]; of grids about the axis on both sides of it."""
    rr = need_rerun()
    grid, field = bed.fields.grid, bed.fields
    across, z = grid.points if isinstance(grid, Ring) else grid.points[::-1]
    speed, inside = np.linalg.norm(field.velocity, axis=0), bed.pattern.bed
    if not isinstance(grid, Ring):
        speed, inside = speed.T, inside.T
    wide, high = (float(line[1] - line[0]) / 2 if len(line) > 1 else 1e-3 for line in (across, z))
    i, k = np.nonzero(inside)
    colours = np.repeat(speed_colours(speed[i, k], fastest)[:, :3], 4, axis=0)
    sides = (1, -1) if isinstance(grid, Ring) else (1,)
    x = np.concatenate([side * across[i] for side in sides])
    middle = np.stack([x, np.zeros_like(x), np.tile(z[k], len(sides))], axis=1)
    corner = np.array([(-wide, 0, -high), (wide, 0, -high), (wide, 0, high), (-wide, 0, high)])
    first = 4 * np.arange(len(middle))[:, None]
    mesh = rr.Mesh3D(
        vertex_positions=(middle[:, None] + corner).reshape(-1, 3).astype(np.float32),
        triangle_indices=(first[:, None] + np.array([(0, 1, 2), (0, 2, 3)])).reshape(-1, 3),
        vertex_colors=np.tile(colours, (len(sides), 1)),
    )
    stream.log(f"{below(root)}mean_flow", mesh, static=True)


def send_flow_rate(
    stream, root: str, curve: tuple[np.ndarray, np.ndarray], steady: Steady | None, name: str, number: int = 0
) -> None:
    """Send W(t) as scalars on the clock of the grains, with a box over the window, as high as the mean.

    Args:
        stream: Stream of rerun.
        root: Entity above the curve.
        curve: Times [s] and rates [g/s], each of shape [n].
        steady: Window and mean; None: no box.
        name: Name of the curve.
        number: Place among runs side by side, from 0.
    """
    rr = need_rerun()
    path, colour = f"{below(root)}flow_rate", COLOURS[number % len(COLOURS)]
    stream.log(path, rr.SeriesLines(colors=colour, widths=2 * _BOX, names=name), static=True)
    stream.send_columns(path, [rr.TimeColumn(CLOCK, duration=curve[0])], rr.Scalars.columns(scalars=curve[1]))
    if steady is None:
        return
    pale = [round(0.45 * channel + 0.55 * 128) for channel in colour]
    line = rr.SeriesLines(colors=pale, widths=_MEAN, names=f"mean: {steady.mean}", aggregation_policy="off")
    stream.log(f"{path}/window", line, static=True)
    clock = rr.TimeColumn(CLOCK, duration=[steady.begin, steady.begin, steady.end, steady.end])
    stream.send_columns(f"{path}/window", [clock], rr.Scalars.columns(scalars=[0.0, steady.rate, steady.rate, 0.0]))


def below(root: str) -> str:
    """Prefix of the paths of entities below `root`."""
    return f"{root}/" if root else ""
