"""Discharge of a small flat silo: its dependence on outlet, friction and filling height."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from labbook.backend.probes import Crossing
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import D, G, hertz, scene
from labbook.checks.verify.platform import MemberStart, Platform, require
from labbook.filling.opening import start_of_discharge
from labbook.filling.placing import place
from labbook.scene import Scene, WedgeHopper

COUNT = 500
WIDTH = 12
"""Of the silo [d]; COUNT grains stand 3.4 widths high."""
DT = 2.5e-5
"""A tenth of the Rayleigh time of grains with a shear modulus of 1e6 Pa."""
SEEDS = (1, 2, 3, 4)
HIGH, MIDDLE, LOW = 460, 320, 180
"""Grains left in the silo: after the start-up; half-way; when they stand 1.2 widths high."""
OUT = Crossing()


def silo(orifice: float, friction: float) -> Scene:
    """The silo with an outlet of `orifice` [d], and grains and walls of one friction coefficient."""
    container = WedgeHopper(width=WIDTH * D, height=200 * D, thickness=1.01 * D, orifice=orifice * D)
    return scene(COUNT, hertz(shear_modulus=1e6, friction=friction), container, G)


def passages(platform: Platform, scenes: Sequence[Scene]) -> list[np.ndarray]:
    """Times [s] at which grains leave each scene, ascending, averaged over SEEDS by rank."""
    starts = [
        MemberStart(s.close(), DT, place(s.close(), "gas", seed), settled_below=1e-3) for s in scenes for seed in SEEDS
    ]
    settled = platform.run_all(starts, 60, until_event=True)
    opens = [s for s in scenes for _ in SEEDS]
    discharges = platform.run_all(
        [MemberStart(s, DT, start_of_discharge(m.end, m.scene, s)) for s, m in zip(opens, settled, strict=True)],
        40,
        probes=[OUT],
    )
    times = []
    for trajectory in discharges:
        leaving = np.sort(trajectory.rows(OUT)["time"])
        require(len(leaving) >= COUNT - LOW, f"only {len(leaving)} grains have left: the silo clogged")
        times.append(leaving[: COUNT - LOW])
    return list(np.reshape(times, (len(scenes), len(SEEDS), -1)).mean(axis=1))


def rate(times: np.ndarray, first: int, last: int) -> float:
    """Grains per second from when `first` grains are left to when `last` are."""
    return (first - last) / float(times[COUNT - last - 1] - times[COUNT - first - 1])


def _falling(rates: Sequence[float]) -> float:
    """Largest ratio of a rate to the one before it: below 1 if they fall."""
    return max(b / a for a, b in pairwise(rates))


def _with_outlet(platform: Platform) -> Mapping[str, float]:
    scenes = [silo(orifice, 0.5) for orifice in (9, 7.5, 6)]
    rates = [rate(times, HIGH, LOW) for times in passages(platform, scenes)]
    return {"largest W(smaller D)/W(D)": _falling(rates)}


def _with_friction(platform: Platform) -> Mapping[str, float]:
    scenes = [silo(7.5, friction) for friction in (0.05, 0.2, 0.8)]
    rates = [rate(times, HIGH, LOW) for times in passages(platform, scenes)]
    return {"largest W(larger mu)/W(mu)": _falling(rates)}


def _with_height(platform: Platform) -> Mapping[str, float]:
    """A liquid would flow 25 % faster from the upper half, which stands 2.7 widths high in the mean, not 1.7."""
    (times,) = passages(platform, [silo(7.5, 0.5)])
    return {"|W(upper half)/W(lower half) - 1|": abs(rate(times, HIGH, MIDDLE) / rate(times, MIDDLE, LOW) - 1)}


CASES = [
    Case(
        name="flow-outlet",
        statement="W increases with the outlet",
        source="Beverloo et al. 1961",
        measures={"largest W(smaller D)/W(D)": limited(0.9)},
        run=_with_outlet,
        slow=True,
    ),
    Case(
        name="flow-friction",
        statement="W decreases with friction",
        source="Fan et al. 2023",
        measures={"largest W(larger mu)/W(mu)": limited(0.97)},
        run=_with_friction,
        slow=True,
    ),
    Case(
        name="flow-height",
        statement="W does not depend on the filling height above 1.2 widths",
        source="Janssen 1895; Beverloo et al. 1961",
        measures={"|W(upper half)/W(lower half) - 1|": limited(0.1)},
        run=_with_height,
        slow=True,
    ),
]
