"""From a scene to the features that it needs."""

import math
from collections.abc import Sequence

from labbook_dem import features

from labbook.backend import Capabilities, Spec, Unsupported
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.scene import Scene
from labbook_warp.build import most_parts

MOST_CONTACTS = 32  # bits of a mask
LONGEST_CHECK, OFTENEST = 50, 1
"""Steps between two checks of displacements, at most and at least: a check costs about a step, and decides nothing
about the motion."""


def specialise(capabilities: Capabilities, scene: Scene, numerics: Numerics, probes: Sequence[Probe]) -> Spec:
    """Features compiled in. Raises Unsupported."""
    found = features.specialise(capabilities, scene, numerics, probes)
    walls, most = len(scene.container.walls()), MOST_CONTACTS // most_parts(dict(found.features))
    if walls > most:
        raise Unsupported("container", f"the backend {capabilities.name} takes {most} walls, not {walls}")
    return found


def check_interval(scene: Scene, numerics: Numerics) -> int:
    """Steps between two checks, even: a grain that falls through three diameters moves by a tenth of the skin."""
    d = scene.grains.diameter
    speed = math.sqrt(6 * scene.gravity * d) or d / (1000 * numerics.dt)
    steps = int(0.1 * numerics.skin * d / (speed * numerics.dt))
    return max(OFTENEST, min(LONGEST_CHECK, 2 * (steps // 2)))
