"""Energy ledger: the work of contact forces on a grain, in a cycle in which load and shear come and go."""

import math
from collections.abc import Mapping

import numpy as np

from labbook.backend.probes import Contacts, Dissipation, Ledger, Sample
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import LAWS, D, G, floor, linear, scene
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory, grains_at
from labbook.checks.verify.rolling import static_overlap
from labbook.scene import Box, Primitives, Scene, SurfaceChange

DURATION = 1e-3
"""Some ten periods of the vibration on the floor [s]."""
DT = 5e-7
PROBES = LEDGER, MOTION, CONTACTS = Ledger(), Sample(fields=("x", "v", "omega")), Contacts()


def _vibrating(platform: Platform, law: str, dt: float, kick: tuple[float, float, float], height: float) -> Trajectory:
    """A grain on a frictional floor, `height` static overlaps above equilibrium; velocity `kick` [m/s]."""
    surface = SurfaceChange(rolling_friction=0.0)
    scene_at_rest = scene(1, LAWS[law](restitution=0.5), Primitives(parts=(floor(),)), G, floor=surface)
    overlap = static_overlap(scene_at_rest, scene_at_rest.grains.mass * G)
    start = grains_at([0.0, 0.0, D / 2 + (height - 1) * overlap], kick)
    return platform.run(MemberStart(scene_at_rest, dt, start), round(DURATION / dt), 1, PROBES)


def contact_power(trajectory: Trajectory) -> np.ndarray:
    """Power [W] of the contact forces on the one grain at each step: force times velocity of the point of contact."""
    grain = trajectory.by_beat(MOTION, ("vx", "vy", "vz", "wx", "wy", "wz"))[:, 0]
    rows = trajectory.rows(CONTACTS)
    at = np.searchsorted(trajectory.rows(LEDGER)["step"], rows["step"])
    force, branch = (np.stack([rows[part + axis] for axis in "xyz"], axis=1) for part in "fb")
    velocity = grain[at, :3] + np.cross(grain[at, 3:], branch)
    return np.bincount(at, np.sum(force * velocity, axis=1), len(grain))


def gaps(trajectory: Trajectory) -> tuple[float, float]:
    """Largest gap of the energy balance during the motion, over the energy at the start.

    Returns:
        The gap with the work of the ledger, and with `contact_power` integrated by the trapezoidal rule.
    """
    table, dt = trajectory.rows(LEDGER), trajectory.numerics.dt
    energy, unit = table["kinetic"] + table["potential"], float(table["kinetic"][0])
    power = contact_power(trajectory)
    work = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2 * dt)])
    balance = energy - table["contact_work"]
    start = _energy_at_start(trajectory)
    return float(np.abs(balance - start).max()) / unit, float(np.ptp(energy - work)) / unit


def _energy_at_start(trajectory: Trajectory) -> float:
    grains: Scene = trajectory.scene
    overlap = static_overlap(grains, grains.grains.mass * G)
    return grains.grains.mass * (G * (D / 2 - overlap) + 0.5 * float(np.dot(KICK, KICK)))


KICK = (3e-4, 0.0, -3e-4)
"""Velocity [m/s] that presses and shears the resting contact, not hard enough to end it."""


def _cycle(law: str):
    def run(platform: Platform) -> Mapping[str, float]:
        coarse, fine = (gaps(_vibrating(platform, law, dt, KICK, 0.0)) for dt in (2 * DT, DT))
        orders = [math.log2(a / b) for a, b in zip(coarse, fine, strict=True)]
        return {
            "gap, ledger": fine[0],
            "|order - 2|, ledger": abs(orders[0] - 2),
            "gap, integrated power": fine[1],
            "|order - 2|, integrated power": abs(orders[1] - 2),
        }

    return run


def _impact(platform: Platform) -> Mapping[str, float]:
    """A grain that hits the floor obliquely and leaves it: all work is done, and the balance is exact."""
    errors = {}
    for law in LAWS:
        table = _vibrating(platform, law, 2 * DT, (0.3, 0.0, -0.3), 100.0).rows(LEDGER)
        energy = table["kinetic"] + table["potential"]
        lost = float(energy[0] - energy[-1])
        errors[law] = abs(lost + float(table["contact_work"][-1])) / lost
    return errors


POWERS = Dissipation()
SLIDES = 0.05
"""Initial velocity [m/s] of a sphere that slides until it rolls."""
TUMBLES = 0.3
"""Initial speeds [m/s] of spheres in a small box."""


def dissipated(trajectory: Trajectory, *names: str) -> np.ndarray:
    """Sum of the powers `names` integrated by the trapezoidal rule from the start, at each step that was read [J]."""
    table = trajectory.rows(POWERS)
    power = np.sum([table[name] for name in names], axis=0)
    first = power[0] * table["time"][0]
    return first + np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2 * np.diff(table["time"]))])


def _slide(platform: Platform) -> Mapping[str, float]:
    """A sphere slides on a floor until it rolls: friction takes 2/7 of its energy, whatever its coefficient."""
    scene_at_rest = scene(1, linear(friction=0.3, restitution=0.5), Primitives(parts=(floor(),)), G,
                  floor=SurfaceChange(rolling_friction=0.0))  # fmt: skip
    overlap = static_overlap(scene_at_rest, scene_at_rest.grains.mass * G)
    start = grains_at([0.0, 0.0, D / 2 - overlap], [SLIDES, 0.0, 0.0])
    dt, steps = 1e-6, 10
    beats = round(1.3 * 2 * SLIDES / (7 * 0.3 * G) / (dt * steps))
    trajectory = platform.run(MemberStart(scene_at_rest, dt, start), beats, steps, (LEDGER, POWERS))
    energy = 0.5 * scene_at_rest.grains.mass * SLIDES**2
    tangential, normal = (dissipated(trajectory, name)[-1] / energy for name in ("tangential_power", "normal_power"))
    return {"friction": abs(tangential / (2 / 7) - 1), "normal part": abs(normal)}


def tumbling(platform: Platform, dt: float) -> float:
    """Largest gap in the balance of eight spheres in a closed box, over the energy that contacts took.

    Kinetic + potential energy and the integrals of both powers add up to a constant.
    """
    width = 2.6 * D
    box = Box(width=width, depth=width, height=width, lid=True)
    law = linear(restitution=0.5, rolling_friction=0.0)
    rng = np.random.default_rng(4)
    corner = np.stack(np.meshgrid(*[[-1, 1]] * 3), axis=-1).reshape(-1, 3)
    x = corner * 0.6 * D + [0, 0, width / 2]
    start = grains_at(x, rng.normal(0, TUMBLES, (8, 3)))
    trajectory = platform.run(MemberStart(scene(8, law, box, G), dt, start), round(3e-3 / dt), 1, (LEDGER, POWERS))
    table = trajectory.rows(LEDGER)
    energy = table["kinetic"] + table["potential"]
    balance = energy + dissipated(trajectory, "normal_power", "tangential_power")
    return float(np.abs(balance - balance[0]).max() / (energy[0] - energy[-1]))


def _tumbling(platform: Platform) -> Mapping[str, float]:
    coarse, fine = (tumbling(platform, dt) for dt in (4e-6, 2e-6))
    return {"gap": fine, "gap over that of twice the step": fine / coarse}


CASES = [
    *(
        Case(
            name=f"energy-cycle-{law}",
            statement="kinetic + potential energy - contact work is constant during loading and shear: order dt^2",
            source="work of forces",
            measures={
                "gap, ledger": limited(1e-3),
                "|order - 2|, ledger": limited(0.2),
                "gap, integrated power": limited(1e-3),
                "|order - 2|, integrated power": limited(0.1),
            },
            run=_cycle(law),
        )
        for law in LAWS
    ),
    Case(
        name="energy-impact",
        statement="after an oblique impact with friction and damping, the work of the contact is the energy lost",
        source="work of forces",
        measures={law: limited(1e-12, steps=100) for law in LAWS},
        run=_impact,
    ),
    Case(
        name="energy-slide",
        statement="a sphere that slides until it rolls loses 2/7 of its energy to friction, and none along the normal",
        source="Coulomb's law: v = 5/7 v_0",
        measures={"friction": limited(1e-3), "normal part": limited(1e-6)},
        run=_slide,
    ),
    Case(
        name="energy-parts",
        statement="kinetic + potential energy and the powers of normal and tangential forces balance: order dt^2",
        source="work of forces",
        measures={"gap": limited(1e-3), "gap over that of twice the step": limited(0.3)},
        run=_tumbling,
    ),
]
