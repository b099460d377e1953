"""Choice of time step, stiffness and precision that meet a tolerated error at the least cost.

The error of a mean of n runs is |bias| + half width of its interval, and the half width goes as n^{-1/2}. With a bias
of at most b, n = (s t/(e - b))^2 runs meet the error e, where s is the scatter between runs and t Student's quantile.
Their cost goes as n/dt for fillings and discharges, whatever s is. A softer bed allows longer steps but has a larger
bias. Mixed precision makes steps cheaper, and may add to the bias. The choice is the setting with the least
c/(dt (e - b)^2) among those of known b, with c the cost of a step.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from labbook.accuracy.calibration import Bias, Calibration, OutOfRange, shipped
from labbook.accuracy.groups import Groups, groups
from labbook.backend.numerics import Numerics, Precision
from labbook.scene import Scene
from labbook.scene.quantities import percent
from labbook.scene.timescales import collision, largest_stable_step
from labbook.stats import Tolerance

SCALES = (1.0, 0.7, 0.5, 0.3, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02, 0.015, 0.01)
"""Factors on the stiffness to choose from."""
STEPS = (0.01, 0.015, 0.02, 0.025, 0.03, 0.035, 0.04, 0.045, 0.05, 0.055)
"""Time steps to choose from, in parts of the duration of a collision."""
WITHIN = 0.75
"""Largest step to choose, as a part of the largest stable step."""

COSTS: dict[Precision, float] = {"double": 1.0, "mixed": 0.8}
"""Relative cost of a step by precision.

`mixed` takes half of the time of `double` on a GPU, and 0.7 to 1 of it on a CPU (docs/gpu-backend.md,
docs/cpu-backend.md). The backend is not known when a study is read, hence one value for both.
"""


@dataclass(frozen=True)
class Choice:
    """Numerics for an error `tolerance`.

    Args:
        dt: Time step [s].
        stiffness_scale: Factor on the stiffness.
        precision: Precision.
        bias: Bias of W with these numerics.
        tolerance: Tolerated error, as a part of W.
        scatter: Measured standard deviation of ln W from run to run.
        source: Source of the calibration.
        usual: Time step [s] that the study would have without a requested error; None if it states its own.
    """

    dt: float
    stiffness_scale: float
    precision: Precision
    bias: Bias
    tolerance: float
    scatter: float
    source: str
    usual: float | None = None

    @property
    def over_usual(self) -> float:
        """Cost ratio to the usual numerics: steps that meet the tolerance, over those of the usual step without bias.

        1 if there is no usual step.
        """
        return 1.0 if self.usual is None else self.cost() * self.usual * self.tolerance**2

    @property
    def remainder(self) -> float:
        """Part of the tolerance that remains for the half width of the interval."""
        return Tolerance(self.tolerance, self.bias.bound).remainder

    def cost(self) -> float:
        """Number of steps of the runs that meet the tolerance, up to a factor common to all choices."""
        return 1 / (self.dt * self.remainder**2)

    @property
    def time(self) -> float:
        """Time of those steps, up to a factor common to all choices."""
        return COSTS[self.precision] * self.cost()


def choose(
    scene: Scene,
    closed: Scene,
    tolerance: float,
    *,
    dt: float | None = None,
    stiffness_scale: float | None = None,
    precision: Precision | None = None,
    usual: float | None = None,
    calibration: Calibration | None = None,
) -> Choice:
    """Choose the cheapest setting that meets `tolerance`.

    Args:
        scene: Scene of the flow.
        closed: Scene of the filling, with the same numerics.
        tolerance: Tolerated error, as a part of W.
        dt: Stated time step [s], which is kept; None: to be chosen.
        stiffness_scale: Stated factor on the stiffness; None: to be chosen.
        precision: Stated precision; None: to be chosen. `mixed` is chosen only if its bias is known. If it is stated
            with an unknown bias, the bias is that of step and stiffness alone.
        usual: Time step [s] without a requested error.
        calibration: The calibration; None: the one that ships.

    Returns:
        The choice.

    Raises:
        NotMeasured: No such scene was measured.
        OutOfRange: No measured setting meets the tolerance.
    """
    nominal = _groups_of(scene, 1.0, 1.0)
    scenes = (calibration or shipped()).of(nominal)
    best: Choice | None = None
    reasons: list[str] = []
    scales = SCALES if stiffness_scale is None else (stiffness_scale,)
    rounding = scenes.mixed
    available: tuple[Precision, ...] = ("double",) if rounding is None else ("double", "mixed")
    precisions = available if precision is None else (precision,)
    cheapest = min(COSTS[name] for name in precisions)
    settings = [
        (step, scale) for scale in scales for step in ((dt,) if dt is not None else _steps(scene, closed, scale))
    ]
    # groups at a step of 1 s; the group `step` is proportional to dt, so that others follow by a factor
    soft = {scale: _groups_of(scene, 1.0, scale) for scale in scales}
    for step, scale in sorted(settings, reverse=True):
        if best is not None and cheapest / (step * tolerance**2) >= best.time:
            break  # no shorter step is cheaper, were it without bias
        numerics = replace(soft[scale], step=step * soft[scale].step)
        try:
            bias = scenes.bias(nominal, numerics, numerics)
        except OutOfRange as reason:
            reasons.append(str(reason))
            continue
        for name in precisions:
            total = bias if name == "double" or rounding is None else bias + rounding
            candidate = Choice(step, scale, name, total, tolerance, scenes.scatter, scenes.source, usual)
            if candidate.remainder <= 0:
                moves = f"dt/t_c = {numerics.step:.3g} moves W by up to {percent(total.bound, '.2f')}"
                reasons.append(f"{moves}, and {percent(tolerance)} is asked")
            elif best is None or candidate.time < best.time:
                best = candidate
    if best is None:
        raise OutOfRange(reasons[-1] if reasons else "no time step is stable")
    return best


def bias_of(scene: Scene, flow: Numerics, filled: Numerics, calibration: Calibration | None = None) -> Bias:
    """Bias of W in `scene` with the numerics of flow and filling, as a part of W. Raises OutOfRange."""
    flowing, bed = (_groups_of(scene, numerics.dt, numerics.stiffness_scale) for numerics in (flow, filled))
    scenes = (calibration or shipped()).of(flowing)
    bias = scenes.bias(_groups_of(scene, flow.dt, 1.0), flowing, bed)
    if flow.precision == "double":
        return bias
    if scenes.mixed is None:
        raise OutOfRange(f"precision {flow.precision}")
    return bias + scenes.mixed


def _groups_of(scene: Scene, dt: float, scale: float) -> Groups:
    dimensionless = groups(scene, dt, scale)
    if dimensionless is None:
        raise OutOfRange("no scene with such an outlet, bed or materials was calibrated")
    return dimensionless


def _steps(scene: Scene, closed: Scene, scale: float) -> Iterator[float]:
    """Yield the time steps [s] that are stable in the flow and in the filling.

    They are rounded to six digits, so that keys do not depend on the last bit of a square root.
    """
    soft = scene.stiffened(scale)
    limit = WITHIN * min(largest_stable_step(soft), largest_stable_step(closed.stiffened(scale)))
    duration = collision(soft)
    yield from (float(f"{fraction * duration:.6g}") for fraction in STEPS if fraction * duration <= limit)
