"""What guards say when they stop a member."""


def explain(guard: str, grain: int, step: int, value: float, diameter: float) -> str:
    """Message of a failed guard. value: overlap [m] or speed [m/s]; diameter of a grain [m]."""
    when = f"grain {grain} at step {step}"
    if guard == "overlap":
        return f"{when} overlaps by {value / diameter:.2f} d; try a smaller time step"
    if guard == "speed":
        return f"{when} moves at {value:.3g} m/s; try a smaller time step"
    return f"{when} has a velocity that is no number; try a smaller time step"
