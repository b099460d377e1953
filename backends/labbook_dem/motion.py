"""Advancing a body by one step: leapfrog with predicted velocities.

Kept are positions at whole steps and velocities at half steps. Forces at step n depend on velocities, which a leapfrog
does not have there; they see the prediction u_n = v_{n-1/2} + a_{n-1} dt/2, so that damping and friction are second
order in dt too (with v_{n-1/2} in their place, as is common, they are first order).
"""

from labbook_dem.words import func, wide, wide3


@func
def kick(v: wide3, a: wide3, dt: wide):
    """v_{n+1/2} [m/s] from v_{n-1/2} and the acceleration a_n; also for angular velocities."""
    return v + a * dt


@func
def drift(x: wide3, v: wide3, dt: wide):
    """x_{n+1} [m] from x_n and v_{n+1/2}."""
    return x + v * dt


@func
def predict(v: wide3, a: wide3, dt: wide):
    """u_{n+1} [m/s] from v_{n+1/2} and a_n."""
    return v + a * (wide(0.5) * dt)
