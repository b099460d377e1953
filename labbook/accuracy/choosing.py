"""Time step, stiffness and precision for an error that can be tolerated, at the least cost.

The error of a mean of n runs is |bias| + half width of its interval, and the half width goes as n^{-1/2}. With a bias
of at most b, n = (s t/(e - b))^2 runs meet the error e, where s is the scatter between runs and t Student's quantile.
Their cost goes as n/dt, both for fillings and discharges, whatever s is. A softer bed allows longer steps and has a
larger bias, and so may mixed precision have, whose steps cost less: the choice is the setting with the least
c/(dt (e - b)^2), c the cost of a step, of those whose b is known.
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
"""Factors on the stiffness among which is chosen."""
STEPS = (0.01, 0.015, 0.02, 0.025, 0.03, 0.035, 0.04, 0.045, 0.05, 0.055)
"""Time steps in parts of the duration of a collision."""
WITHIN = 0.75
"""Part of the largest stable step that no step exceeds but a stated one."""

COSTS: dict[Precision, float] = {"double": 1.0, "mixed": 0.8}
"""Of a step: `mixed` takes half of the time of `double` on a GPU and 0.7 to 1 of it on a CPU (docs/gpu-backend.md,
docs/cpu-backend.md), and which of them it will be is not known when a study is read."""


@dataclass(frozen=True)
class Choice:
    """`dt` [s], `stiffness_scale` and `precision` for an error `tolerance`, a part of W.

    `bias`: what they do to W; `left`: what of the tolerance is left to the scatter between runs; `scatter`: its
    standard deviation from run to run, as measured. `source`: of the calibration.
    """

    dt: float
    stiffness_scale: float
    precision: Precision
    bias: Bias
    tolerance: float
    scatter: float
    source: str
    usual: float | None = None
    """The time step [s] that the study would have without a requested error; None if it states its own."""

    @property
    def over_usual(self) -> float:
        """Steps that meet the tolerance, over those of the usual step and the stated stiffness, were they without any
        bias; 1 where there is no usual step."""
        return 1.0 if self.usual is None else self.cost() * self.usual * self.tolerance**2

    @property
    def left(self) -> float:
        """What of the tolerance is left for the half width of the interval."""
        return Tolerance(self.tolerance, self.bias.bound).left

    def cost(self) -> float:
        """Steps of the runs that meet the tolerance, up to a factor that all choices share."""
        return 1 / (self.dt * self.left**2)

    @property
    def time(self) -> float:
        """The same of their time."""
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
    """The cheapest setting that meets `tolerance` in `scene`, filled as `closed` with the same numerics.

    dt [s], stiffness_scale, precision: stated ones, which are kept. usual: the step [s] without a requested error.
    Where nothing is known of mixed precision it is not chosen; if it is stated, the bias is that of step and stiffness
    alone. Raises NotMeasured where no such scene was measured; OutOfRange where no setting that was measured meets the
    tolerance.
    """
    stated = _grouped(scene, 1.0, 1.0)
    alike = (calibration or shipped()).of(stated)
    best: Choice | None = None
    reasons: list[str] = []
    scales = SCALES if stiffness_scale is None else (stiffness_scale,)
    rounding = alike.mixed
    either: tuple[Precision, ...] = ("double",) if rounding is None else ("double", "mixed")
    precisions = either if precision is None else (precision,)
    cheapest = min(COSTS[one] for one in precisions)
    settings = [
        (step, scale) for scale in scales for step in ((dt,) if dt is not None else _steps(scene, closed, scale))
    ]
    soft = {scale: _grouped(scene, 1.0, scale) for scale in scales}  # steps of 1 s, in proportion to which groups go
    for step, scale in sorted(settings, reverse=True):
        if best is not None and cheapest / (step * tolerance**2) >= best.time:
            break  # no shorter step is cheaper, were it without bias
        made = replace(soft[scale], step=step * soft[scale].step)
        try:
            bias = alike.bias(stated, made, made)
        except OutOfRange as reason:
            reasons.append(str(reason))
            continue
        for one in precisions:
            total = bias if one == "double" or rounding is None else bias + rounding
            found = Choice(step, scale, one, total, tolerance, alike.scatter, alike.source, usual)
            if found.left <= 0:
                moves = f"dt/t_c = {made.step:.3g} moves W by up to {percent(total.bound, '.2f')}"
                reasons.append(f"{moves}, and {percent(tolerance)} is asked")
            elif best is None or found.time < best.time:
                best = found
    if best is None:
        raise OutOfRange(reasons[-1] if reasons else "no time step is stable")
    return best


def bias_of(scene: Scene, flow: Numerics, filled: Numerics, calibration: Calibration | None = None) -> Bias:
    """What these numerics of the flow and of the filling do to W in `scene`, in parts of it. Raises OutOfRange."""
    made, bed = (_grouped(scene, one.dt, one.stiffness_scale) for one in (flow, filled))
    alike = (calibration or shipped()).of(made)
    bias = alike.bias(_grouped(scene, flow.dt, 1.0), made, bed)
    if flow.precision == "double":
        return bias
    if alike.mixed is None:
        raise OutOfRange(f"precision {flow.precision}")
    return bias + alike.mixed


def _grouped(scene: Scene, dt: float, scale: float) -> Groups:
    found = groups(scene, dt, scale)
    if found is None:
        raise OutOfRange("no scene with such an outlet, bed or materials was calibrated")
    return found


def _steps(scene: Scene, closed: Scene, scale: float) -> Iterator[float]:
    """Time steps [s] that are stable in the flow and in the filling, rounded to six digits, so that keys do not hang on
    the last bit of a square root."""
    soft = scene.stiffened(scale)
    limit = WITHIN * min(largest_stable_step(soft), largest_stable_step(closed.stiffened(scale)))
    duration = collision(soft)
    yield from (float(f"{part * duration:.6g}") for part in STEPS if part * duration <= limit)
