"""What guards measure by, and what they say when they stop a member."""

from labbook.backend.numerics import Numerics
from labbook.scene import Scene


def finest(scene: Scene) -> float:
    """Diameter [m] of the smallest grains, by which overlaps are judged."""
    return min(grains.diameter for grains in scene.grains.smallest())


def explain(guard: str, grain: int, step: int, value: float, scene: Scene, numerics: Numerics) -> str:
    """Message of a failed guard: which grain, when, by how much, and what to change.

    guard: overlap, speed, spin, or state for all that is NaN or too large to be counted. value: overlap [m] or speed
    [m/s]; of no meaning for the others.
    """
    where = f"grain {grain} at step {step} ({span(step * numerics.dt)}, dt = {span(numerics.dt)})"
    if guard == "overlap":
        return (
            f"{where} overlaps by {value / finest(scene):.3g} d, more than numerics.overlap_limit "
            f"({numerics.overlap_limit:g}); use a smaller numerics.dt or stiffer grains, or raise the limit"
        )
    if guard == "speed":
        return (
            f"{where} moves at {value:.3g} m/s, faster than numerics.speed_limit ({numerics.speed_limit:g} m/s); "
            "use a smaller numerics.dt, or raise the limit if grains may be this fast"
        )
    what = "its spin is NaN" if guard == "spin" else "its velocity or a force on it is NaN or too large"
    return f"{where}: {what}; use a smaller numerics.dt"


def span(seconds: float) -> str:
    """A simulated time for people: 0.25 s, 12 ms, 2.5 us."""
    for unit, scale in (("s", 1.0), ("ms", 1e-3)):
        if abs(seconds) >= 0.1 * scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"
