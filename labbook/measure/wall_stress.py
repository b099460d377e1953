"""Stress on the walls of a silo: before the opening, while it changes after it, and in steady flow.

Signs: sigma_n is positive in compression. The shear stress is that of the wall on the bed, positive upwards: it is
positive where the wall carries weight. Of level walls it is positive outwards, or along x.
"""

import math
from dataclasses import dataclass

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import TRACTION_SUMS, Above, Crossing, Probe, Traction
from labbook.measure.data import RunData
from labbook.measure.expected import beats_of, rounded, window_time
from labbook.measure.measure import (
    Evaluation,
    Measure,
    MeasureError,
    Quantity,
    Window,
    as_arrays,
    flow_suffix,
    from_arrays,
    while_flowing,
    window_in_words,
)
from labbook.measure.steady import BLOCKS, outflow
from labbook.scene import Bodies, Scene, Spherocylinders
from labbook.scene.hulls import upper_reach
from labbook.scene.timescales import gravity_time
from labbook.scene.wall_bins import WallBins, all_walls, areas, bins_of_walls, is_upright
from labbook.scene.walls import Wall
from labbook.stats import Measured

NAME = "wall_stress"
SIZE = 2.0
"""Width of bins, in d*."""
_EVERY = 0.5
"""Time between two frames, in sqrt(d*/g)."""
_FRAMES = 400
"""Frames within the window, at most, if the outflow is as expected."""
FILTER = 5.0
"""Time over which forces are averaged before their peak is taken, in sqrt(d*/g)."""
FILTERS = (1.0, 2.5, 5.0, 10.0, 20.0)
"""Such times for which the peak of the force on the upright walls is given."""
OPENING = 50.0
"""Time after the opening within which peaks are looked for, in sqrt(d*/g)."""
_SATURATED = (0.25, 0.75)
"""Part of the height between the lowest and the highest bin in use, in which K is taken."""
_SUM = {name: place for place, name in enumerate(TRACTION_SUMS)}
_FORCE, _TORQUE, _MOMENT = (slice(_SUM[a], _SUM[b] + 1) for a, b in (("fx", "fz"), ("tx", "tz"), ("mx", "mz")))
_LOCAL = slice(_SUM["normal"], _SUM["across"] + 1)
CARRIED = "carried."
"""Prefix of the names of the part of the weight that a wall carries."""
_AT_REST = (
    Quantity("weight_balance", "ΣF_z/(M g) − 1", "", "vertical forces of all walls on the bed at rest over its "
             "weight, less 1", "%", 100, about_zero=True),
    Quantity("wall_friction", "μ_m", "", "mobilised friction: shear over normal force of upright walls, at rest"),
    Quantity("sliding_share", "sliding", "", "contacts at upright walls above 95 % of the Coulomb limit, at rest",
             "%", 100),
    Quantity("stress_ratio", "K", "", "normal stress of upright walls over mean vertical stress, at rest"),
)  # fmt: skip
_IN_FLOW = (
    Quantity("weight_balance_flow", "balance in flow", "", "vertical forces of walls and momentum of the outflow over "
             "the weight of the bed, less 1, mean over the window", "%", 100, about_zero=True),
    Quantity("wall_friction_flow", "μ_m in flow", "", "shear over normal force of upright walls, in the window"),
    Quantity("sliding_share_flow", "sliding in flow", "", "contacts at upright walls above 95 % of the Coulomb limit, "
             "in the window", "%", 100),
    Quantity("wall_switch", "S", "", "normal force on upright walls in the window over that at rest"),
)  # fmt: skip
_OPENING = Quantity("wall_overshoot", "P", "", "peak of the normal force on upright walls after the opening, averaged "
                    "over 5 sqrt(d*/g), over that at rest")  # fmt: skip


@dataclass(frozen=True, eq=False)
class WallStresses:
    """Forces of walls on the bed, by wall and bin.

    There are W walls, B bins and n frames. Attributes beginning with `rest` are those of the bed at rest; those
    beginning with `flow` are means over the window.

    Attributes:
        names: Names of the walls, shape [W].
        coordinates: Coordinate of the bins of each wall, such as `height`, shape [W].
        upright: Mask of the upright walls, shape [W].
        friction: Friction coefficient of each wall, shape [W].
        wall: Index of the wall of each bin, shape [B].
        low, high: Ends of each bin in the coordinate of its wall [m], shape [B].
        area: Area of each bin [m^2], shape [B]; NaN if it is not known.
        rest_area: The same of the closed container [m^2], shape [B].
        rest, flow: Forces normal, along and across [N], shape [B, 3].
        flow_error: Standard errors of `flow` from blocks [N], shape [B, 3].
        rest_contacts, flow_contacts: Number of contacts, shape [B].
        rest_sliding, flow_sliding: Number of sliding contacts, shape [B].
        weight_above: Weight of the bed at rest above the middle of each bin [N], shape [B]; NaN for level walls.
        rest_force, flow_force: Forces of walls [N], shape [W, 3].
        rest_torque, flow_torque: Torques about the origin [N m], shape [W, 3].
        rest_point, flow_point: Mean contact points weighted by normal force [m], shape [W, 3].
        time: Times of the frames [s], shape [n].
        wall_force: Forces of walls in each frame [N], shape [n, W, 3].
        opening_time: Middles of the moving means after the opening [s], shape [m].
        opening: Moving means over FILTER of the normal force of each bin [N], shape [m, B].
        peaks: Peak of the normal force on upright walls after the opening over that at rest, for each of FILTERS.
        weight: Weight of the bed at rest [N].
        section: Area of the horizontal section [m^2]; NaN if it is not known.
        perimeter: Length of the section along upright walls with friction [m]; NaN if it is not known.
        density: Density of the bulk at rest [kg/m^3]; NaN if it is not known.
        surface: Effective free surface at rest, z [m]; NaN if it is not known.
        floor: Height above which all upright walls stand [m].
        gravity: Acceleration of gravity [m/s^2].
        window: Begin and end of the steady part [s], shape [2].
    """

    names: np.ndarray
    coordinates: np.ndarray
    upright: np.ndarray
    friction: np.ndarray
    wall: np.ndarray
    low: np.ndarray
    high: np.ndarray
    area: np.ndarray
    rest_area: np.ndarray
    rest: np.ndarray
    rest_contacts: np.ndarray
    rest_sliding: np.ndarray
    flow: np.ndarray
    flow_error: np.ndarray
    flow_contacts: np.ndarray
    flow_sliding: np.ndarray
    weight_above: np.ndarray
    rest_force: np.ndarray
    rest_torque: np.ndarray
    rest_point: np.ndarray
    flow_force: np.ndarray
    flow_torque: np.ndarray
    flow_point: np.ndarray
    time: np.ndarray
    wall_force: np.ndarray
    opening_time: np.ndarray
    opening: np.ndarray
    peaks: np.ndarray
    weight: float
    section: float
    perimeter: float
    density: float
    surface: float
    floor: float
    gravity: float
    window: np.ndarray

    @classmethod
    def of(cls, evaluation: Evaluation) -> "WallStresses | None":
        """Read the stresses from an evaluation; None without any."""
        return from_arrays(cls, evaluation.arrays)

    def of_wall(self, name: str) -> np.ndarray:
        """Mask of the bins of a wall, shape [B]."""
        return self.names[self.wall] == name

    @property
    def on_upright(self) -> np.ndarray:
        """Mask of the bins of upright walls, shape [B]."""
        return self.upright[self.wall]

    @property
    def at_rest(self) -> bool:
        """True if the bed was observed at rest."""
        return bool(np.isfinite(self.rest).any())

    def vertical_stress(self) -> np.ndarray:
        """Mean vertical stress [Pa] at rest, at the middle of each bin of an upright wall, shape [B]; else NaN."""
        return self.hanging(self.rest, self.weight_above)

    def hanging(self, force: np.ndarray, weight_above: np.ndarray) -> np.ndarray:
        """Compute the mean vertical stress at the middle of each bin of an upright wall.

        It follows from the balance of the bed above: its weight, less the shear of upright walls there, over the
        section.

        Args:
            force: Forces of walls as in `rest` [N], shape [B, 3].
            weight_above: Weight of the bed above the middle of each bin [N], shape [B].

        Returns:
            Stress [Pa], shape [B]; NaN for bins of other walls.
        """
        carried = np.zeros(len(self.wall))
        for number in np.flatnonzero(self.upright):
            mask = self.wall == number
            below = np.concatenate([[0.0], np.cumsum(force[mask, 1])])
            edges = np.append(self.low[mask], self.high[mask][-1])
            # linear within a bin: half of the shear of a bin is above its middle
            carried += below[-1] - np.interp(self.middle, edges, below)
        return np.where(self.on_upright, (weight_above - carried) / self.section, math.nan)

    @property
    def middle(self) -> np.ndarray:
        """Coordinates [m] of the middles of bins, shape [B]."""
        return (self.low + self.high) / 2

    @property
    def lowest(self) -> float:
        """z [m] of the lower end of the profile that is compared with Janssen's: half a hydraulic diameter above
        `floor`, so that what the bottom carries is left out."""
        return self.floor + self.hydraulic / 2

    @property
    def hydraulic(self) -> float:
        """Hydraulic diameter 4 A/P [m] of the section; of a cylinder its diameter."""
        return 4 * self.section / self.perimeter if self.perimeter > 0 else math.nan

    def in_use(self, size: float) -> np.ndarray:
        """Mask of the bins of upright walls that Janssen's law is fitted to: above `lowest`, and more than `size` [m]
        below the free surface."""
        return self.on_upright & (self.low >= self.lowest) & (self.high <= self.surface - size)


class WallStress(Measure):
    """Measure normal and shear stress on walls by height, on level walls by radius or x, with forces and torques.

    Quantities ending in `_flow` are those in the window of the flow rate, in closed containers in the second half of
    the run. The others are those of the bed at rest, before the opening and with the lid in place.

    Quantities:
        weight_balance, weight_balance_flow: Vertical forces of all walls, in flow with the momentum of the outflow,
            over the weight of the bed, less 1.
        carried.WALL: Vertical force of a wall over the weight.
        wall_friction, wall_friction_flow: Mobilised friction, shear over normal force of upright walls.
        sliding_share, sliding_share_flow: Fraction of their contacts above 95 % of the Coulomb limit.
        stress_ratio: K, normal stress of upright walls over mean vertical stress.
        wall_overshoot: Peak of the normal force on upright walls after the opening, averaged over 5 sqrt(d*/g), over
            that at rest.
        wall_switch: Normal force on upright walls in the window over that at rest.

    Arrays:
        names, coordinates, upright, ...: Those of `WallStresses`.

    Raises:
        MeasureError: There is no gravity, or there are no walls.
    """

    name = NAME
    version = 2  # 2: grains of a fed bed that have left and are not back yet do not count as its weight
    declared = (*_AT_REST, _OPENING, *_IN_FLOW, *map(while_flowing, _IN_FLOW))

    def check(self, scene: Scene) -> None:
        if scene.gravity == 0:
            reason = "wall_stress is sampled at a multiple of sqrt(d*/g), and there is no gravity"
            raise MeasureError(reason, "take wall_stress out of measure, or use a gravity above 0 m/s^2")
        if not all_walls(scene.container):
            raise MeasureError("wall_stress: there are no walls", "take wall_stress out of measure")

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        """List also the fraction of the weight that each wall carries."""
        carried = tuple(
            Quantity(f"{CARRIED}{wall.name}", f"carried by {wall.name}", "",
                     f"vertical force of the wall {wall.name} on the bed at rest over its weight", "%", 100,
                     about_zero=True)
            for wall in all_walls(scene.container)
        )  # fmt: skip
        return (*self.declared, *carried)

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        self.check(scene)
        plane, expected = scene.container.outlet_plane, window_time(scene)
        every = _EVERY * gravity_time(scene)
        if math.isfinite(expected):
            every = max(every, rounded(expected / _FRAMES, scene, 1))
        traction = Traction(size=bin_width(scene), every=beats_of(every, numerics))
        if plane is None:
            return (traction,)
        inside = () if scene.feed is None else (Above((plane,), every=traction.every),)
        return Crossing(plane), traction, *inside

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        if "traction" not in run.tables:
            raise MeasureError("wall_stress: the run recorded no forces of walls; run it again with this measure")
        frames = _Frames(run)
        begin, end, words = steady_part(run, window)
        within = (frames.time >= begin) & (frames.time <= end) & (frames.time > 0)
        record = _stresses(run, frames, within, (begin, end))
        numbers = [*_at_rest(record, run), *_after_opening(record), *_in_flow(record, run, int(within.sum()), words)]
        return Evaluation(tuple(numbers), as_arrays(record))


def bin_width(scene: Scene) -> float:
    """Width of bins [m]."""
    return SIZE * scene.grains.equivalent_diameter


class _Frames:
    """Sums of all frames of a run, shape [n, B, 14]; `time` [s], 0 at rest."""

    def __init__(self, run: RunData):
        table = run.tables["traction"]
        self.walls: tuple[Wall, ...] = all_walls(run.scene.container)
        self.bins: tuple[WallBins, ...] = bins_of_walls(run.scene, self.walls, bin_width(run.scene))
        first = np.cumsum([0, *(bins.count for bins in self.bins)])
        steps, frame = np.unique(table["step"], return_inverse=True)
        self.time = steps * run.numerics.dt
        self.sums = np.zeros((len(steps), int(first[-1]), len(TRACTION_SUMS)))
        counts = np.array([bins.count for bins in self.bins])
        # a contact at the end of a wall may round into a bin beyond the last
        index = first[table["wall"]] + np.minimum(table["bin"], counts[table["wall"]] - 1)
        for name, column in _SUM.items():
            np.add.at(self.sums[:, :, column], (frame, index), np.asarray(table[name], float))
        self.wall = np.repeat(np.arange(len(self.bins)), counts)

    def by_wall(self, sums: np.ndarray) -> np.ndarray:
        """Sums of bins, shape [..., B, 14], added up for each wall."""
        return np.stack([sums[..., self.wall == k, :].sum(axis=-2) for k in range(len(self.walls))], axis=-2)


def steady_part(run: RunData, window: Window) -> tuple[float, float, str]:
    """Find begin and end [s] of the steady part, NaN without any, and describe it in words."""
    if run.scene.container.outlet_plane is None:
        return run.duration / 2, run.duration, f"{run.duration / 2:.4g} s to {run.duration:.4g} s"
    flow, _ = outflow(run, window)
    if flow is None:
        return math.nan, math.nan, window_in_words(window)
    return flow.begin, flow.end, f"{window_in_words(window)} ({flow.begin:.4g} s to {flow.end:.4g} s)"


def _stresses(run: RunData, frames: _Frames, within: np.ndarray, window: tuple[float, float]) -> WallStresses:
    scene, time = run.scene, frames.time
    bins = [(b, k) for b in frames.bins for k in range(b.count)]
    rest = frames.sums[time == 0].sum(axis=0) if (time == 0).any() else np.full(frames.sums.shape[1:], math.nan)
    flow, error = _mean(frames.sums[within])
    moving = frames.sums[(time > 0) & (time <= (OPENING + FILTER) * gravity_time(scene))]
    times = time[(time > 0)][: len(moving)]
    opening_time, opening = _moving(times, moving[:, :, _SUM["normal"]], FILTER * gravity_time(scene))
    walls_at_rest, walls_in_flow = frames.by_wall(rest), frames.by_wall(flow)
    upright = np.array([is_upright(wall) for wall in frames.walls])
    friction = np.array([scene.surface(wall).friction for wall in frames.walls])
    area = np.concatenate([areas(scene.container, w, b) for w, b in zip(frames.walls, frames.bins, strict=True)])
    # at rest the lid is in place, and level walls have more area
    closed = scene.container.close()
    walls_by_name = {wall.name: wall for wall in (*frames.walls, *closed.walls())}
    pairs = zip(frames.walls, frames.bins, strict=True)
    rest_area = np.concatenate([areas(closed, walls_by_name[wall.name], b) for wall, b in pairs])
    # walls without friction carry no weight, and do not count in Janssen's perimeter
    section, perimeter = _section(scene, frames, upright & (friction > 0))
    above = _WeightAbove(run)
    middle = np.array([b.low + (k + 0.5) * b.size for b, k in bins])
    heights = np.array([b.along == "height" for b, _ in bins])
    floor = max(
        (b.low for b, is_wall_upright in zip(frames.bins, upright, strict=True) if is_wall_upright), default=math.nan
    )
    density, surface = above.bulk(section, floor, 2 * section / perimeter if perimeter else 0.0)
    normal = rest[upright[frames.wall], _SUM["normal"]].sum()
    peaks = [_peak(times, moving, upright[frames.wall], tau * gravity_time(scene)) / normal for tau in FILTERS]
    return WallStresses(
        names=np.array([wall.name for wall in frames.walls], "U40"),
        coordinates=np.array([b.along for b in frames.bins], "U8"),
        upright=upright,
        friction=friction,
        wall=frames.wall,
        low=np.array([b.low + k * b.size for b, k in bins]),
        high=np.array([b.low + (k + 1) * b.size for b, k in bins]),
        area=area,
        rest_area=rest_area,
        rest=rest[:, _LOCAL],
        rest_contacts=rest[:, _SUM["contacts"]],
        rest_sliding=rest[:, _SUM["sliding"]],
        flow=flow[:, _LOCAL],
        flow_error=error[:, _LOCAL],
        flow_contacts=flow[:, _SUM["contacts"]],
        flow_sliding=flow[:, _SUM["sliding"]],
        weight_above=np.where(heights, above(middle), math.nan),
        rest_force=walls_at_rest[:, _FORCE],
        rest_torque=walls_at_rest[:, _TORQUE],
        rest_point=_points(walls_at_rest),
        flow_force=walls_in_flow[:, _FORCE],
        flow_torque=walls_in_flow[:, _TORQUE],
        flow_point=_points(walls_in_flow),
        time=time,
        wall_force=frames.by_wall(frames.sums)[:, :, _FORCE],
        opening_time=opening_time,
        opening=opening,
        peaks=np.array(peaks),
        weight=above.total,
        section=section,
        perimeter=perimeter,
        density=density,
        surface=surface,
        floor=floor,
        gravity=scene.gravity,
        window=np.array(window),
    )


def _section(scene: Scene, frames: _Frames, frictional: np.ndarray) -> tuple[float, float]:
    """Area [m^2] of the horizontal section, and the length [m] of it along the upright walls that have friction; NaN
    where that cannot be told."""
    lengths = []
    for wall, bins in zip(frames.walls, frames.bins, strict=True):
        if is_upright(wall):
            high = areas(scene.container, wall, bins)
            lengths.append(float(high.max()) / bins.size if len(high) else math.nan)
        else:
            lengths.append(0.0)
    area = scene.container.area
    upright_shapes = [wall.shape for wall in frames.walls if is_upright(wall)]
    if area is None and len(upright_shapes) == 1 and "axial" in upright_shapes[0].symmetries:
        area = math.pi * upright_shapes[0].reach ** 2
    return math.nan if area is None else area, float(np.array(lengths)[frictional].sum())


class _WeightAbove:
    """Weight [N] of a bed at rest above a height."""

    def __init__(self, run: RunData):
        grains, start = run.scene.grains, run.start
        bodies = Bodies.of(grains, start)
        self.gravity, self.weight = run.scene.gravity, bodies.mass * run.scene.gravity
        self.z, self.reach = start.x[:, 2], bodies.radius.copy()
        if start.q is not None:  # extent of a rod along z
            q = start.q / np.linalg.norm(start.q, axis=1)[:, None]
            if isinstance(grains, Spherocylinders):
                w, x, y, z = q.T
                self.reach += grains.half_length * np.abs(w * w - x * x - y * y + z * z)
            else:
                self.reach = np.asarray(upper_reach(grains, bodies.radius, q))
        self.total = float(self.weight.sum())

    def __call__(self, heights: np.ndarray) -> np.ndarray:
        """Above each of the heights [m]; of grains that are cut as of spheres, by the volume of the cap."""
        weights = np.empty(len(heights))
        for k, height in enumerate(heights):
            t = np.clip((self.z - height) / self.reach, -1.0, 1.0)
            weights[k] = self.weight @ ((2 + 3 * t - t**3) / 4)
        return weights

    def bulk(self, section: float, floor: float, margin: float) -> tuple[float, float]:
        """Density [kg/m^3] of the bulk, between `margin` [m] above the `floor` [m] of the upright walls and the height
        above which a tenth of the weight is, and z [m] of a level surface of a bed of this density."""
        low, high = floor + margin, float(np.quantile(self.z, 0.9))
        if not (math.isfinite(section) and high - low > 2 * self.reach.max()):
            return math.nan, math.nan
        above, top = self(np.array([low, high]))
        per_height = (above - top) / (high - low)
        return float(per_height / (section * self.gravity)), float(low + above / per_height)


def _points(by_wall: np.ndarray) -> np.ndarray:
    """Mean contact points [m] weighted by normal force, shape [W, 3]; NaN without contact."""
    normal = by_wall[:, _SUM["normal"], None]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(normal > 0, by_wall[:, _MOMENT] / normal, math.nan)


def _mean(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean over frames, and its standard error from blocks; NaN of too few frames."""
    none = np.full(sums.shape[1:], math.nan)
    if not len(sums):
        return none, none
    length = len(sums) // BLOCKS
    if length < 2:
        return sums.mean(axis=0), none
    # frames that fill no block are left out at the begin
    blocks = sums[len(sums) - length * BLOCKS :].reshape(BLOCKS, length, *sums.shape[1:]).mean(axis=1)
    return sums.mean(axis=0), blocks.std(axis=0, ddof=1) / math.sqrt(BLOCKS)


def _moving(time: np.ndarray, values: np.ndarray, tau: float) -> tuple[np.ndarray, np.ndarray]:
    """Moving means over `tau` [s] of values [n, B], with the middle of their times; none of too few frames."""
    if len(time) < 2:
        return np.zeros(0), np.zeros((0, *values.shape[1:]))
    count = max(1, round(tau / float(time[1] - time[0])))
    if len(time) < count:
        return np.zeros(0), np.zeros((0, *values.shape[1:]))
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    means = (total[count:] - total[:-count]) / count
    return (time[count - 1 :] + time[: len(means)]) / 2, means


def _peak(time: np.ndarray, sums: np.ndarray, upright: np.ndarray, tau: float) -> float:
    # the peak of the sum, not the sum of peaks: bins have their peaks at different times
    _, means = _moving(time, sums[:, upright, _SUM["normal"]].sum(axis=1), tau)
    return float(means.max()) if len(means) else math.nan


def _ratio(numerator: float, denominator: float) -> float:
    return numerator / denominator if denominator > 0 else math.nan


def _at_rest(record: WallStresses, run: RunData) -> list[Measured]:
    where, how = "bed at rest", "one frame; error from seeds only"
    upright = record.on_upright
    normal, shear, _ = record.rest[upright].sum(axis=0)
    touching, sliding = record.rest_contacts[upright].sum(), record.rest_sliding[upright].sum()
    vertical = record.vertical_stress()
    used = record.in_use(run.scene.grains.equivalent_diameter)
    low, high = (record.low[used].min(), record.high[used].max()) if used.any() else (math.nan, math.nan)
    middle = (record.low + record.high) / 2
    inner = used & (middle >= low + _SATURATED[0] * (high - low)) & (middle <= low + _SATURATED[1] * (high - low))
    pressed = record.rest[inner, 0].sum() / record.rest_area[inner].sum() if inner.any() else math.nan
    values = {
        "weight_balance": float(record.rest_force[:, 2].sum() / record.weight - 1),
        "wall_friction": _ratio(float(shear), float(normal)),
        "sliding_share": _ratio(float(sliding), float(touching)),
        "stress_ratio": _ratio(float(pressed), float(vertical[inner].mean())) if inner.any() else math.nan,
        **{f"{CARRIED}{name}": float(force[2] / record.weight)
           for name, force in zip(record.names.tolist(), record.rest_force, strict=True)},
    }  # fmt: skip
    note = "" if record.at_rest else "the bed at rest was not observed"
    numbers = []
    for name, value in values.items():
        lacking = note or ("" if math.isfinite(value) else _LACKING.get(name, ""))
        numbers.append(Measured(name, value, math.nan, 1 if math.isfinite(value) else 0, where, how, "", lacking))
    return numbers


_LACKING = {
    "wall_friction": "no upright wall is touched",
    "sliding_share": "no upright wall is touched",
    "stress_ratio": "the bed is too low: no bin is between half a hydraulic diameter above the bottom and the surface",
}


def _after_opening(record: WallStresses) -> list[Measured]:
    value, where = float(record.peaks[FILTERS.index(FILTER)]), f"{OPENING:g} sqrt(d*/g) after the opening"
    how = f"largest moving mean over {FILTER:g} sqrt(d*/g); error from seeds only"
    note = "" if math.isfinite(value) else "too few frames, no contact with upright walls, or no frame at rest"
    return [Measured("wall_overshoot", value, math.nan, len(record.opening_time), where, how, "", note)]


def _in_flow(record: WallStresses, run: RunData, count: int, where: str) -> list[Measured]:
    suffix, how = flow_suffix(run), f"mean of {count} frames; error from seeds only"
    upright = record.on_upright
    normal, shear, _ = record.flow[upright].sum(axis=0)
    rest = record.rest[upright, 0].sum()
    values = {
        "weight_balance_flow": _balance(record, run),
        "wall_friction_flow": _ratio(float(shear), float(normal)),
        "sliding_share_flow": _ratio(float(record.flow_sliding[upright].sum()),
                                     float(record.flow_contacts[upright].sum())),
        "wall_switch": _ratio(float(normal), float(rest)),
    }  # fmt: skip
    lacking = "" if count else "no frame within the window"
    if not lacking and run.scene.feed is not None and "above" not in run.tables:
        lacking = "the run did not record the mass inside; run it again"
    return [
        Measured(name + suffix, value, math.nan, count, where, how, "", "" if math.isfinite(value) else lacking)
        for name, value in values.items()
    ]


def _balance(record: WallStresses, run: RunData) -> float:
    """Vertical forces of walls and momentum of the outflow over the weight of the bed less 1, over the window."""
    begin, end = record.window.tolist()
    force = float(record.flow_force[:, 2].sum())
    if not math.isfinite(force) or not end > begin:
        return math.nan
    if run.scene.container.outlet_plane is None:
        return force / record.weight - 1
    table = run.tables["crossing"]
    mass = Bodies.of(run.scene.grains, run.start).mass[run.start.rows(np.asarray(table["id"]))]
    time, speed = np.asarray(table["time"], float), -np.asarray(table["vz"], float)
    flowing = (time >= begin) & (time <= end)
    momentum = float((mass * speed)[flowing].sum()) / (end - begin)
    if run.scene.feed is not None:
        if (stream := run.scene.feed.stream) is not None:  # as much enters as leaves, at this velocity
            momentum += float(mass[flowing].sum()) / (end - begin) * stream.velocity[2]
        return (force + momentum) / _fed_weight(run, begin, end) - 1
    # a grain is missing from its passage on: its share of the window is its share of the lost weight
    left = run.scene.gravity * float((mass * np.clip(end - time, 0, end - begin)).sum()) / (end - begin)
    return (force + momentum) / (record.weight - left) - 1


def _fed_weight(run: RunData, begin: float, end: float) -> float:
    """Mean weight [N] of the grains above the outlet from `begin` to `end` [s]; NaN if the run did not record it.

    Grains that have left and wait for their return do not count. They return between two beats only, so the mass within
    a beat is that at its end plus that of the grains that leave until then.
    """
    if "above" not in run.tables:
        return math.nan
    table, crossing, beat = run.tables["above"], run.tables["crossing"], run.numerics.beat
    time = np.asarray(table["step"]) * run.numerics.dt
    frames = (time >= begin) & (time <= end)
    if not frames.any():
        return math.nan
    left = np.asarray(crossing["time"], float)
    masses = Bodies.of(run.scene.grains, run.start).mass[run.start.rows(np.asarray(crossing["id"]))]
    after = np.searchsorted(time[frames], left)  # the frame at the end of the beat, if that has one
    ends = np.append(time[frames], math.inf)[after]
    fraction = np.clip(1 - (ends - left) / beat, 0, 1)
    inside = np.asarray(table["mass"], float)[frames].mean() + float((masses * fraction).sum()) / frames.sum()
    return float(inside) * run.scene.gravity
