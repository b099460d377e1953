"""Default ends of the window and of the run: the bed has to be high enough for a steady flow.

Walls carry the weight of a bed that is higher than wide (Janssen 1895), so that its flow does not depend on its height:
above HIGH widths as `labbook verify flow-height` measures it. Below that the flow of a discharge drifts.
"""

import math
from collections.abc import Iterable, Sequence

from labbook.filling.bed import discharged_at
from labbook.scene import Scene
from labbook.study.point import Point
from labbook.study.schema import EARLIEST, LATEST, MARGIN, Settings, Stop, Window

HIGH = 1.2
"""Widths of the container that a bed has to be high for its flow not to depend on that."""
_STEP = 0.05


def resolved(settings: Settings, points: Sequence[Point]) -> tuple[Window, Stop]:
    """Window and stop rule with what the study leaves out: of all points the same, so that they can be compared."""
    window, stop = settings.window, settings.stop
    if points[0].scene.feed is not None:
        return window.endless(), stop
    if window.timed:
        return window, stop
    if "end" not in window.model_fields_set:
        window = window.model_copy(update={"end": _end(stop, [point.scene for point in points])})
    if "discharged" not in stop.model_fields_set:
        stop = stop.model_copy(update={"discharged": min(1.0, round(window.end + MARGIN, 9))})
    return window, stop


def _end(stop: Stop, scenes: Iterable[Scene]) -> float:
    """Discharged fraction at which the lowest of the beds is still high enough, in whole steps."""
    fractions = [fraction for scene in scenes if (fraction := high_until(scene)) is not None]
    end = math.floor(min([LATEST, *fractions]) / _STEP + 1e-9) * _STEP
    latest = stop.discharged if "discharged" in stop.model_fields_set else 1.0
    return min(round(max(end, EARLIEST), 9), latest)


def high_until(scene: Scene) -> float | None:
    """Discharged fraction up to which the bed of a scene is HIGH widths of its container high; 0 or less if it never
    is, None where the container does not tell."""
    sizes = vars(scene.container)
    across = [sizes[key] for key in ("width", "diameter") if key in sizes]
    return discharged_at(scene, HIGH * max(across)) if across else None
