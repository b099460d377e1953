"""A sphere slides without friction over the rounded edge of an outlet, and leaves it where nothing presses it on.

The centre moves on a circle of the radius rho = r + R about the axis of the edge. It leaves where m v^2 / rho has come
up to m g cos t: at cos t = (2 + v0^2 / (g rho)) / 3, with v0 the speed on the plate. Its horizontal speed is constant
from there on, v cos t, so that it can be read long after. Rigid bodies are the limit of stiff ones (see `edge`).
"""

import math
from collections.abc import Mapping
from functools import partial

import numpy as np

from labbook.backend.probes import Sample
from labbook.checks.verify import edge
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import D, G, linear, scene
from labbook.checks.verify.platform import MemberStart, Platform, require
from labbook.checks.verify.rolling import lever
from labbook.scene import CylinderSilo, Scene, SurfaceChange, WedgeHopper
from labbook.scene.packing import Packing
from labbook.scene.thick_plate import Lip

R = D / 2
STIFF, DT, STEPS = edge.STIFF / 16, 4 * edge.DT, edge.STEPS
HALF_OUTLET = 10 * D
LIP = Lip(radius=0.75 * D, thickness=2 * D)
BEGIN = HALF_OUTLET + LIP.radius
"""Distance from the axis at which the edge begins to bend [m]."""
MOTION = Sample(fields=("x", "v"))


def rounded(round_hole: bool) -> Scene:
    """One grain in an open, wide and deep silo without friction, with a rounded edge."""
    smooth, size = SurfaceChange(friction=0.0, rolling_friction=0.0), 60 * D
    if round_hole:
        silo = CylinderSilo(diameter=size, height=40 * D, orifice=2 * HALF_OUTLET, lip=LIP)
        return scene(1, linear(normal_stiffness=STIFF), silo, G, bottom=smooth)
    hopper = WedgeHopper(width=size, height=40 * D, thickness=40 * D, orifice=2 * HALF_OUTLET, lip=LIP)
    return scene(1, linear(normal_stiffness=STIFF), hopper, G, **{"bottom-left": smooth})


def _slides(platform: Platform, round_hole: bool) -> Mapping[str, float]:
    silo = rounded(round_hole)
    rho = LIP.radius + lever(silo)
    push = 0.75 * math.sqrt(G * rho)
    start = Packing(
        x=np.array([[-BEGIN - 0.2 * R, 0.0, lever(silo)]]), v=np.array([[push, 0.0, 0.0]]), omega=np.zeros((1, 3))
    )
    trajectory = platform.run(MemberStart(silo, DT, start), 600, STEPS, (MOTION,))
    x, z, v = trajectory.by_beat(MOTION, ("x", "z", "vx"))[:, 0].T
    off = (x > -BEGIN) & (np.hypot(x + BEGIN, z + LIP.radius) > LIP.radius + R)
    require(bool(off[-1]) and not off[0], "the grain has not left the edge")
    cosine = (2 + push**2 / (G * rho)) / 3
    left = math.sqrt(G * rho * cosine) * cosine
    at = math.hypot(x[~off][-1] + BEGIN, z[~off][-1] + LIP.radius)
    return {
        "horizontal speed after it": abs(float(v[-1]) / left - 1),
        "distance from the axis of the edge": abs(at / rho - 1),
    }


CASES = [
    Case(
        name=f"lip-{name}",
        statement=f"a sphere that slides without friction over the rounded edge of {outlet} leaves it as a rigid body",
        source="m v² / rho = m g cos t and energy",
        measures={
            "horizontal speed after it": limited(1e-4),
            "distance from the axis of the edge": limited(1e-5),
        },
        run=partial(_slides, round_hole=name == "hole"),
    )
    for name, outlet in (("slot", "a slot"), ("hole", "a round hole"))
]
