"""Scenes that engines are timed on."""

from labbook.numerics import Numerics
from labbook.scene import HertzMindlin, Scene, Spheres, WedgeHopper

FAN_STEP = Numerics(dt=2.5e-6)


def fan(orifice: float = 0.03, grains: int = 3000) -> Scene:
    """Flat-bottomed quasi-2D hopper of Fan et al. 2023: 3 mm spheres, Hertz-Mindlin, `orifice` [m]."""
    return Scene(
        grains=Spheres(diameter=3e-3, density=2500, count=grains),
        contact=HertzMindlin(
            shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, rolling_friction=0.01, restitution=0.2
        ),
        container=WedgeHopper(width=0.1, height=0.4, thickness=3.03e-3, orifice=orifice),
    )
