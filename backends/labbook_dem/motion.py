"""Integration by one step: leapfrog with positions at whole steps and velocities at half steps (velocity Verlet for
forces that depend on positions only)."""

from labbook_dem.words import func, wide


@func
def kick(v: wide, a: wide, dt: wide):
    """v_{n+1/2} [m/s] from v_{n-1/2} and the acceleration a_n; one component, also of angular velocities."""
    return v + a * dt


@func
def drift(x: wide, v: wide, dt: wide):
    """x_{n+1} [m] from x_n and v_{n+1/2}; one component."""
    return x + v * dt


@func
def predict(v: wide, a: wide, dt: wide):
    """Velocity [m/s] at step n + 1 for forces that depend on it, from v_{n+1/2} and a_n; one component."""
    return v + a * (wide(0.5) * dt)
