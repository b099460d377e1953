"""Area fraction and velocity of the grains along the outlet line.

The area fraction phi(x) is the part of the time during which x is covered by a grain: by its disc in the x-z plane,
which cuts the line z = 0 in a chord of half length sqrt(r^2 - z^2). The velocity is v(x) = sum chord v / sum chord, so
that phi v is the mean of v wherever and whenever the line is covered. A disc of diameter d that passes adds int dt v 2
sqrt(r^2 - z^2) = int dz 2 sqrt(r^2 - z^2) = pi r^2 to phi v, whatever its speed on the way. With (2/3) d rho_p pi r^2 =
rho_p (4/3) pi r^3 this is its mass, and (2/3) d rho_p int(phi v dx) = W exactly.

Frames of the grains near the line estimate these means without bias. The passages of centres through the line are
recorded too. They would give phi only if the whole body kept the speed that it has at z = 0. But a grain that rolls
over an edge at 0.15 m/s doubles its speed within its own radius, and the balance would close for any speeds. Some
papers nevertheless use these passages: v is the mean over the grains that cross, and phi follows from the flow.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe, Slab
from labbook.measure.data import RunData
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
from labbook.measure.series import mean_mass
from labbook.measure.steady import SteadyFlow, gaps, in_gap, outflow
from labbook.scene import Scene, container
from labbook.scene.bodies import Bodies
from labbook.stats import Measured

BINS = 24
"""Bins of x* = (x - e)/R from -1 to 1: as many for every outlet, so that profiles can be laid over each other."""
_FEWEST = 12
"""Frames below which there is no profile."""
COVERAGE, CROSSINGS = "outlet_profiles", "outlet_crossings"
DEFINITIONS = {
    COVERAGE: "phi: the part of the time during which a place is covered; v: the mean speed while it is",
    CROSSINGS: "v: the mean speed of the grains that cross; phi: what then makes up their flow",
}
"""Definitions of the profiles. Fast grains weigh more in the second: the flow is the same, v and phi are not."""


def _velocity(flux: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    return np.divide(flux, fraction, out=np.full_like(flux, math.nan), where=fraction > 0)


@dataclass(frozen=True, eq=False)
class OutletProfile:
    """Profiles along one outlet, means over a window of time.

    Attributes:
        edges: Edges of the bins, in x* = (x - e)/R from -1 (at the left side) to 1, shape [m + 1].
        R: Half width of the outlet [m].
        area_fraction: Area fraction phi, shape [m].
        flux: phi v [m/s], positive downwards, shape [m].
        crossing_flux: Disc area of the grains whose centres crossed within a bin, over time and width [m/s], shape [m].
        crossing_velocity: Mean of -v_z over them [m/s], which weighs fast grains more, shape [m]; NaN without any.
        flow: (2/3) d rho_p int(phi v dx) [kg/s].
        counted: Mass flow rate of the grains that left [kg/s].
        closure_error: Standard error of flow/counted.
        frames: Number of frames.
    """

    edges: np.ndarray
    R: float
    area_fraction: np.ndarray
    flux: np.ndarray
    crossing_flux: np.ndarray
    crossing_velocity: np.ndarray
    flow: float
    counted: float
    closure_error: float
    frames: int

    @classmethod
    def of(cls, evaluation: Evaluation) -> "OutletProfile | None":
        """Read the profiles from an evaluation of `OutletProfiles`; None for too few grains."""
        return from_arrays(cls, evaluation.arrays)

    @property
    def velocity(self) -> np.ndarray:
        """v = phi v / phi [m/s], shape [m]; NaN where no grain ever was."""
        return _velocity(self.flux, self.area_fraction)

    @property
    def crossing_fraction(self) -> np.ndarray:
        """Area fraction that gives the flux of the crossing grains at their mean speed, shape [m]; 0 without any."""
        crossed = self.crossing_velocity > 0
        return np.divide(self.crossing_flux, self.crossing_velocity, out=np.zeros_like(self.flux), where=crossed)

    def outlets(self, radius: float) -> Mapping[str, "ProfileAcross"]:
        """Return the profiles by each of DEFINITIONS, for grains of a `radius` [m]."""
        return {
            # Centres stay a radius away from the edges: nearer to them the area fraction falls by geometry, whatever
            # the flow. Crossings have no such margin, since a centre either crosses there or does not.
            COVERAGE: ProfileAcross(
                self.R, self.edges, self.area_fraction, self.flux, 1 - radius / self.R, self.counted
            ),
            CROSSINGS: ProfileAcross(self.R, self.edges, self.crossing_fraction, self.crossing_flux, 1.0, self.counted),
        }

    @property
    def closure(self) -> float:
        """Ratio of the flow rate of the profiles to the counted one; 1 within its error."""
        return self.flow / self.counted


@dataclass(frozen=True, eq=False)
class ProfileAcross:
    """Profiles along one outlet, of one run or the mean of several.

    Attributes:
        R: Half width of the outlet [m].
        edges: Edges of the bins, in x* = (x - e)/R from -1 to 1, shape [m + 1].
        area_fraction: Area fraction phi, shape [m].
        flux: phi v [m/s], shape [m].
        reach: Largest |x*| of the bins that are fitted.
        counted: Counted flow rate [kg/s].
    """

    R: float
    edges: np.ndarray
    area_fraction: np.ndarray
    flux: np.ndarray
    reach: float
    counted: float

    @property
    def velocity(self) -> np.ndarray:
        """v = phi v / phi [m/s], shape [m]; NaN where no grain ever was."""
        return _velocity(self.flux, self.area_fraction)

    @property
    def inside(self) -> np.ndarray:
        """Mask of the bins within `reach`, shape [m]."""
        return np.maximum(abs(self.edges[1:]), abs(self.edges[:-1])) <= self.reach * (1 + 1e-9)

    @property
    def has_flow(self) -> bool:
        """True if there is a shape to fit: moving grains in bins within `reach` on both sides of the middle."""
        finite = np.isfinite(self.velocity)
        pairs = self.inside & finite & finite[::-1]
        return bool((np.abs(self.flux[pairs]) > 0).any())


def mean_of(outlets: Sequence[ProfileAcross]) -> ProfileAcross:
    """Average profiles of several runs through equal outlets; velocities are weighted by the area fraction."""
    first = outlets[0]
    return ProfileAcross(
        first.R,
        first.edges,
        np.mean([outlet.area_fraction for outlet in outlets], axis=0),
        np.mean([outlet.flux for outlet in outlets], axis=0),
        first.reach,
        float(np.mean([outlet.counted for outlet in outlets])),
    )


def outlet_profile(run: RunData, window: Window, bins: int = BINS) -> OutletProfile | None:
    """Compute the profiles along the outlet of a run within a window, without its gaps.

    Args:
        run: The run.
        window: The window.
        bins: Number of bins along the outlet.

    Returns:
        The profiles; None for too few grains or frames.

    Raises:
        MeasureError: The outlet is no slot, grains are not spheres, or the run recorded no grains at the outlet.
    """
    if "slab" not in run.tables:
        raise MeasureError("outlet_profiles: the run recorded no grains at the outlet; run it again with this measure")
    slot, bodies = _slot(run.scene), Bodies.of(run.scene.grains, run.start)
    steady, times = outflow(run, window)
    if steady is None:
        return None
    slab, frames = run.tables["slab"], _frames(run, steady, times)
    if len(frames) < _FEWEST:
        return None
    # Frames are numbered by beats, not by rows: one without a grain at the outlet has no row, and counts all the same.
    number = np.asarray(slab["step"]) // run.numerics.steps_per_beat
    frame = np.minimum(np.searchsorted(frames, number), len(frames) - 1)
    in_frame = frames[frame] == number
    edges, R = np.linspace(-1, 1, bins + 1), slot.width / 2
    x, z, v = (np.asarray(slab[name], float)[in_frame] for name in ("x", "z", "vz"))
    ids = np.asarray(slab["id"])[in_frame]
    grain = run.start.rows(ids)
    passage = ids if run.scene.feed is None else _passages(ids, frame[in_frame])
    covered = _covered(x - slot.centre, z, bodies.radius[grain], R * edges)
    width = 2 * R / bins
    phi, flux = covered.sum(axis=0), covered.T @ -v
    behind = bodies.mass / (math.pi * bodies.radius**2)  # (2/3) d rho_p of each grain
    swept = covered.sum(axis=1) * -v * behind[grain]
    flow_rate = float(swept.sum()) / len(frames)
    rate = mean_mass(run) * steady.rate
    error = _sweep_error(swept / bodies.mass[grain], passage, frame[in_frame], len(frames) - 1)
    crossing_flux, crossing_velocity = _at_crossings(run, steady, slot.centre, R * edges, bodies.radius)
    return OutletProfile(
        edges=edges,
        R=R,
        area_fraction=phi / (len(frames) * width),
        flux=flux / (len(frames) * width),
        crossing_flux=crossing_flux,
        crossing_velocity=crossing_velocity,
        flow=flow_rate,
        counted=rate,
        closure_error=flow_rate / rate * error,
        frames=len(frames),
    )


_MEANS = (
    Quantity("outlet_closure", "flow of the profiles / W", "", "flow rate of the profiles over that counted"),
    Quantity("outlet_area_fraction", "mean φ at the outlet", "", "mean of the area fraction along the outlet"),
    Quantity("outlet_velocity", "mean v at the outlet", "m/s", "mean velocity along the outlet, weighted by φ"),
)


class OutletProfiles(Measure):
    """Measure profiles of velocity and area fraction along the outlet of a quasi-2D hopper.

    The docstring of this module derives them. Quantities of a run that clogged end in `_flowing`.

    Quantities:
        outlet_closure: Flow rate of the profiles, (2/3) d rho_p int(phi v dx), over that of the counted grains.
        outlet_area_fraction: Mean of phi across the outlet.
        outlet_velocity: int(phi v dx) / int(phi dx) [m/s].

    Arrays:
        edges, R, area_fraction, flux, ...: Those of `OutletProfile`.

    Raises:
        MeasureError: The outlet is no slot, or grains are not spheres.
    """

    name = "outlet_profiles"
    version = 4
    declared = (*_MEANS, *map(while_flowing, _MEANS))

    def check(self, scene: Scene) -> None:
        _slot(scene)

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        plane, radius = _slot(scene).plane, scene.grains.radius
        return (Crossing(plane), Slab(low=plane - radius, high=plane + radius))

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        profile = outlet_profile(run, window)
        where, suffix = window_in_words(window, "grains"), flow_suffix(run)
        if profile is None:
            note = "too few grains at the outlet within the window"
            none = (math.nan, math.nan, 0, where, "chords of grains on the outlet line", "", note)
            return Evaluation((Measured(f"outlet_closure{suffix}", *none),))
        how = f"chords of grains on the outlet line in {profile.frames} frames"
        of_grains = f"{how}; error from the scatter between grains"
        mean_phi = float(profile.area_fraction.mean())
        mean_v = float(profile.flux.sum() / profile.area_fraction.sum()) if mean_phi > 0 else math.nan
        error, n = profile.closure_error, profile.frames
        numbers = (
            Measured(f"outlet_closure{suffix}", profile.closure, error, n, where, of_grains, ""),
            Measured(f"outlet_area_fraction{suffix}", mean_phi, math.nan, n, where, how, ""),
            Measured(f"outlet_velocity{suffix}", mean_v, math.nan, n, where, how, "m/s"),
        )
        return Evaluation(numbers, as_arrays(profile))


def _slot(scene: Scene) -> container.Outlet:
    if scene.container.outlet_form != "slot":
        reason = f"outlet_profiles needs the slot of a wedge-hopper, and the container is a {scene.container.kind}"
        raise MeasureError(reason, "take outlet_profiles out of measure, or use a wedge-hopper")
    if not scene.grains.round:
        reason = f"outlet_profiles applies to spheres only, and these grains are {scene.grains.noun}s"
        raise MeasureError(reason, "take outlet_profiles out of measure, or use spheres")
    return scene.container.outlets[0]


def _frames(run: RunData, flow: SteadyFlow, times: np.ndarray) -> np.ndarray:
    """Numbers of the frames within the window, also of those without a grain; none from gaps without flow."""
    between = run.numerics.beat
    number = np.arange(math.ceil(flow.begin / between), math.floor(min(flow.end, run.duration) / between) + 1)
    return number[~in_gap(number * between, times, flow)]


def _covered(x: np.ndarray, z: np.ndarray, radius: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Length [m] of each bin that the chord of each disc covers, shape [n, m]; the chords are of grains at (x, z)."""
    half = np.sqrt(np.maximum(radius**2 - z**2, 0.0))
    return np.diff(np.clip(edges[None, :], (x - half)[:, None], (x + half)[:, None]), axis=1)


def _at_crossings(
    run: RunData, flow: SteadyFlow, centre: float, edges: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Disc area that crossed each bin over time and width, and the mean of -v_z of its grains [m/s]; shape [m].

    As in the flow rate, neither gaps count nor the grains that end them.
    """
    table = run.tables["crossing"]
    when = np.asarray(table["time"])
    _, after_gaps = gaps(np.sort(when), flow)
    inside = (when > flow.begin) & (when <= flow.end) & ~np.isin(when, after_gaps)
    index = np.searchsorted(edges, np.asarray(table["x"])[inside] - centre) - 1
    within = (index >= 0) & (index < len(edges) - 1)
    index, v = index[within], -np.asarray(table["vz"], float)[inside][within]
    discs = math.pi * radius[run.start.rows(np.asarray(table["id"])[inside][within])] ** 2
    n, total, area = (np.bincount(index, of, len(edges) - 1) for of in (np.ones(len(v)), v, discs))
    time = flow.end - flow.begin - flow.gap_time
    return area / (time * np.diff(edges)), np.divide(total, n, out=np.full(len(n), math.nan), where=n > 0)


def _passages(ids: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Numbers of the passages that rows belong to, where a grain may pass again: it is then away for some frames."""
    order = np.lexsort((frame, ids))
    new = (np.diff(ids[order], prepend=-1) != 0) | (np.diff(frame[order], prepend=0) > 1)
    passage = np.empty(len(ids), int)
    passage[order] = np.cumsum(new)
    return passage


def _sweep_error(swept: np.ndarray, passage: np.ndarray, frame: np.ndarray, last: int) -> float:
    """Relative standard error of the swept total against the counted grains.

    Frames fall on each grain's passage at random. Of the grains on the line when the window opens or closes a random
    part, of variance 1/12, has passed; in a strictly periodic flow these parts cancel.

    Args:
        swept: Swept part of the grain of each row, shape [n].
        passage: Number of the passage of each row, shape [n].
        frame: Number of the frame of each row, shape [n].
        last: Number of the last frame.
    """
    _, grain = np.unique(passage, return_inverse=True)
    total = np.bincount(grain, swept)
    cut = np.isin(np.arange(len(total)), grain[(frame == 0) | (frame == last)])
    whole = total[~cut]
    if len(whole) < 2:
        return math.nan
    on_the_line = len(swept) / (last + 1)
    variance = float(whole.var(ddof=1)) / float(whole.mean()) ** 2 + on_the_line / (6 * len(whole))
    return math.sqrt(variance / len(whole))
