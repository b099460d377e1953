"""The numerics of a study, resolved for a scene: its time step is a time, a part of a time scale, or chosen."""

import math
import re

from labbook.accuracy.choosing import WITHIN
from labbook.filling.placing import column
from labbook.scene.quantities import format_distinct, parse
from labbook.scene.scene import Scene
from labbook.scene.timescales import TIME_SCALES, collision, largest_stable_step
from labbook.study.problems import instead
from labbook.study.schema import FALLS

_FRACTION = re.compile(r"\s*(\S.*?)\s*\*?\s*([a-z]+)\s*")


class TimeStepError(Exception):
    """A time step that cannot be used; `remedy` says what can. `clash`: in this scene, that is."""

    def __init__(self, reason: str, remedy: str, clash: bool = False):
        super().__init__(reason)
        self.remedy, self.clash = remedy, clash


def resolve(value: object, scene: Scene, stiffness_scale: float, closed: Scene | None = None) -> float:
    """The step [s] that `stated` (`2.5 us`, `0.1 rayleigh`, `0.02 collision`) means; None: the law's usual
    one, or less where that is near the largest stable step, which is that of `closed`, the scene of the filling, if
    it is less there.

    Time scales are those of the scene with its stiffness times `stiffness_scale`. A part of one is rounded to six
    digits, so that keys do not hang on the last bit of a square root. Raises TimeStepError.
    """
    remedy = f"write a time such as 2.5 us, or a part of a time scale ({', '.join(TIME_SCALES)}) such as 0.02 collision"
    scaled = scene.stiffened(stiffness_scale)
    limit = largest_stable_step(scaled)
    if closed is not None:
        limit = min(limit, largest_stable_step(closed.stiffened(stiffness_scale)))
    if value is None:
        usual = _multiple_of_a_scale(scene.contact.usual_step, scaled, remedy)
        assert usual is not None
        return min(usual, float(f"{WITHIN * limit:.6g}"))
    if isinstance(value, bool) or not isinstance(value, str):
        number = isinstance(value, int | float) and not isinstance(value, bool)
        raise TimeStepError("the unit is missing" if number else "a time is needed", remedy)
    step = _multiple_of_a_scale(value, scaled, remedy)
    if step is None:
        try:
            step = parse(value, "s", scene.grains.diameter)
        except ValueError as error:
            raise TimeStepError(str(error), remedy) from None
    if not 0 < step <= limit:
        multiple = limit / collision(scaled)
        step_text, limit_text = format_distinct(step, limit, of_limit=3)
        reason = f"a step of {step_text} s is not between 0 and {limit_text} s, above which beds do not come to rest"
        remedy = f"use at most {_rounded_down(multiple):g} collision, or leave numerics.dt out"
        raise TimeStepError(reason, remedy, clash=True)
    return step


def _rounded_down(multiple: float) -> float:
    """`multiple` to two digits, never more than it."""
    unit = 10.0 ** (math.floor(math.log10(multiple)) - 1)
    return float(f"{math.floor(multiple / unit) * unit:.2g}")


def _multiple_of_a_scale(text: str, scene: Scene, remedy: str) -> float | None:
    """The step, or None if `stated` names no time scale."""
    match = _FRACTION.fullmatch(text)
    if match is None:
        return None
    number, name = match.groups()
    if name not in TIME_SCALES:
        hint = instead(name, TIME_SCALES)
        if hint.startswith("did"):
            raise TimeStepError(f"no time scale is called {name}", hint)
        return None
    try:
        multiple = parse(number, "")
    except ValueError as error:
        raise TimeStepError(str(error), remedy) from None
    try:
        return float(f"{multiple * TIME_SCALES[name](scene):.6g}")
    except ValueError as error:
        raise TimeStepError(str(error), f"use {scene.contact.usual_step}", clash=True) from None


def speed_limit(scene: Scene) -> float:
    """FALLS times the speed [m/s] of free fall through a scene: down the height of the container, or of the loose
    column in which its grains start, if that is higher."""
    height = max(getattr(scene.container, "height", 0.0), column(scene))
    return FALLS * math.sqrt(2 * scene.gravity * height)
