"""Symmetries of the equations of motion, on a small hopper that flows through an eccentric outlet."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labbook.backend.probes import Crossing
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import D, G, hertz, scene, spheres
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory, require
from labbook.filling.opening import start_of_discharge
from labbook.filling.placing import place
from labbook.scene import Primitives, Scene, SurfaceMotion, Wall, WedgeHopper
from labbook.scene.packing import Packing

COUNT = 120
SOFT = 1e6
"""Shear modulus [Pa]; with it DT is a tenth of the Rayleigh time."""
DT = 2.5e-5
OUT = Crossing()
_FACTORS = {"x": 4.0, "v": 2.0, "omega": 0.5, "pair_spring": 4.0, "wall_spring": 4.0}


def hopper(length: float = 1.0) -> Scene:
    """Hopper 12 d wide and 80 d high with an eccentric outlet of 6.5 d. `length`: factor of all lengths and moduli."""
    d = D * length
    silo = WedgeHopper(width=12 * d, height=80 * d, thickness=1.01 * d, angle=1.0, orifice=6.5 * d, gap=2 * d)
    grains = spheres(COUNT).model_copy(update={"diameter": d})
    return scene(COUNT, hertz(shear_modulus=SOFT * length), silo, G).model_copy(update={"grains": grains})


def fallen(platform: Platform) -> tuple[Scene, Packing]:
    """Let grains fall into the closed hopper, and open it while they still move."""
    closed = hopper().close()
    trajectory = platform.run(MemberStart(closed, DT, place(closed, "gas", 1)), 4)
    return hopper(), start_of_discharge(trajectory.end, closed, hopper())


def discharge(platform: Platform, scene: Scene, start: Packing, dt: float = DT, steps: int = 3000) -> Trajectory:
    """Discharge for `steps` steps, with the crossings of the outlet."""
    return platform.run(MemberStart(scene, dt, start), 1, steps, [OUT])


def scaled(packing: Packing) -> Packing:
    """Scale a packing: lengths times four, times times two."""
    return replace(packing, **{name: getattr(packing, name) * factor for name, factor in _FACTORS.items()})


def mirrored(scene: Scene) -> Scene:
    """Mirror a scene in x = 0; left and right walls keep their places in the list and swap names."""
    swap = {"left": "right", "right": "left", "bottom-left": "bottom-right", "bottom-right": "bottom-left"}
    parts = []
    for wall in scene.container.walls():
        x, y, z = wall.motion.velocity
        motion = SurfaceMotion(velocity=(-x, y, z), spin=-wall.motion.spin)
        parts.append(Wall(name=swap.get(wall.name, wall.name), shape=wall.shape.mirrored(), motion=motion))
    container = Primitives(parts=tuple(parts), outlet_plane=scene.container.outlet_plane)
    return scene.model_copy(update={"container": container})


def difference(a: Packing, b: Packing) -> float:
    """Largest difference in position [d], over all grains by id; infinite if they hold other grains."""
    assert a.ids is not None
    assert b.ids is not None
    first, second = np.argsort(a.ids), np.argsort(b.ids)
    if not np.array_equal(a.ids[first], b.ids[second]):
        return np.inf
    return float(np.abs(a.x[first] - b.x[second]).max() / D)


def unequal(a: Packing, b: Packing) -> int:
    """Number of components of positions, velocities and spins of a and b that differ in any bit."""
    if len(a) != len(b):
        return max(a.x.size, b.x.size)
    return sum(int(np.sum(getattr(a, name) != getattr(b, name))) for name in ("x", "v", "omega"))


def _unequal_crossings(a: Trajectory, b: Trajectory, factor: float = 1.0) -> int:
    """Number of crossings of a and b that differ in grain or in any bit of the time."""
    first, second = a.rows(OUT), b.rows(OUT)
    if len(first["id"]) != len(second["id"]):
        return max(len(first["id"]), len(second["id"]))
    return int(np.sum((first["id"] != second["id"]) | (first["time"] * factor != second["time"])))


def _scales(platform: Platform) -> Mapping[str, float]:
    open_scene, start = fallen(platform)
    original = discharge(platform, open_scene, start)
    image = discharge(platform, hopper(4.0), scaled(start), 2 * DT)
    _flowed(original)
    return {
        "unequal components": unequal(scaled(original.end), image.end),
        "unequal crossings": _unequal_crossings(original, image, 2.0),
    }


def _mirrors(platform: Platform) -> Mapping[str, float]:
    open_scene, start = fallen(platform)
    original = discharge(platform, open_scene, start)
    image = discharge(platform, mirrored(open_scene), start.mirrored())
    _flowed(original)
    return {
        "unequal components": unequal(original.end.mirrored(), image.end),
        "unequal crossings": _unequal_crossings(original, image),
    }


def _renumbers(platform: Platform) -> Mapping[str, float]:
    open_scene, start = fallen(platform)
    order = np.random.default_rng(4).permutation(len(start))
    differences = []
    for steps in (200, 1000):
        original = discharge(platform, open_scene, start, steps=steps)
        renumbered = discharge(platform, open_scene, start.renumbered(order), steps=steps)
        differences.append(difference(original.end, renumbered.end))
    return {"after 5 ms": differences[0], "after 25 ms": differences[1]}


def _flowed(trajectory: Trajectory) -> None:
    require(len(trajectory.rows(OUT)["id"]) > 20, "too little has flowed for a comparison")


_BITS = {"unequal components": limited(0), "unequal crossings": limited(0)}
CASES = [
    Case(
        name="scale-invariance",
        statement="lengths x 4, times x 2, moduli x 4: the same discharge bit for bit",
        source="dimensional analysis",
        measures=_BITS,
        run=_scales,
    ),
    Case(
        name="mirror",
        statement="a mirrored hopper with an eccentric outlet has the mirrored discharge",
        source="symmetry",
        measures=_BITS,
        run=_mirrors,
    ),
    Case(
        name="renumbering",
        statement="renumbered grains move equally, except for round-off that grows in collisions",
        source="symmetry",
        # forces differ by their roundings over a path of half a diameter, and the difference grows as in double
        measures={
            "after 5 ms": limited(1e-12, "d", roundings=0.5 * 16),
            "after 25 ms": limited(1e-9, "d", roundings=0.5 * 16 * 1000),
        },
        run=_renumbers,
    ),
]
