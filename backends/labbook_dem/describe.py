"""What a scene and a time step come to, for the catalogue."""

import math
from collections.abc import Mapping

from labbook.backend.numerics import Numerics
from labbook.scene import Scene
from labbook_dem import restitution
from labbook_dem.laws import hertz_mindlin, linear

LAWS = {"hertz-mindlin": hertz_mindlin, "linear": linear}


def describe(scene: Scene, numerics: Numerics) -> Mapping[str, float]:
    """Restitution asked for and realised by this step (head-on at sqrt(g d), ten phases: mean and spread), damping."""
    law, grains = LAWS[scene.contact.law], scene.grains
    c = law.coefficients(scene.contact, scene.surface_of_grains, numerics.stiffness_scale)
    speed = math.sqrt(scene.gravity * grains.diameter) or 1.0
    e = restitution.realised(law.normal, c, grains.radius / 2, grains.mass / 2, numerics.dt, speed)
    return {
        "restitution_asked": scene.contact.restitution,
        "restitution_realised": float(e.mean()),
        "restitution_spread": float(e.std()),
        "damping_coefficient": c[1],
    }
