"""What guards measure by, and what they say when they stop a member."""

from labbook.scene import Scene


def finest(scene: Scene) -> float:
    """Diameter [m] of the smallest grains, by which overlaps are judged."""
    return min(grains.diameter for grains in scene.grains.smallest())


def explain(guard: str, grain: int, step: int, value: float, diameter: float) -> str:
    """Message of a failed guard. value: overlap [m] or speed [m/s]; diameter: of the
    smallest grains [m]."""
    when = f"grain {grain} at step {step}"
    if guard == "overlap":
        return f"{when} overlaps by {value / diameter:.2g} d; use a smaller numerics.dt"
    if guard == "speed":
        return f"{when} moves at {value:.3g} m/s; use a smaller numerics.dt"
    return f"{when} has a velocity that is NaN; use a smaller numerics.dt"
