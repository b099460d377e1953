"""The energy ledger: what contacts do to the energy of a grain, in a cycle in which load and shear come and go."""

import math
from collections.abc import Mapping

import numpy as np

from labbook.backend.probes import Contacts, Ledger, Sample
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import LAWS, D, G, floor, scene
from labbook.checks.verify.rolling import static_overlap
from labbook.checks.verify.stand import MemberStart, Motion, Stand, grains_at
from labbook.scene import Primitives, Scene, SurfaceChange

DURATION = 1e-3
"""Some ten periods of the vibration on the floor [s]."""
DT = 5e-7
PROBES = LEDGER, MOTION, CONTACTS = Ledger(), Sample(fields=("x", "v", "omega")), Contacts()


def _vibrating(stand: Stand, law: str, dt: float, kick: tuple[float, float, float], height: float) -> Motion:
    """A grain on a frictional floor, `height` static overlaps above equilibrium; velocity `kick` [m/s]."""
    surface = SurfaceChange(rolling_friction=0.0)
    rests = scene(1, LAWS[law](restitution=0.5), Primitives(parts=(floor(),)), G, floor=surface)
    overlap = static_overlap(rests, rests.grains.mass * G)
    start = grains_at([0.0, 0.0, D / 2 + (height - 1) * overlap], kick)
    return stand.run(MemberStart(rests, dt, start), round(DURATION / dt), 1, PROBES)


def contact_power(motion: Motion) -> np.ndarray:
    """Power [W] of the contact forces on the one grain at each step: force times velocity of the point of contact."""
    grain = motion.by_beat(MOTION, ("vx", "vy", "vz", "wx", "wy", "wz"))[:, 0]
    rows = motion.rows(CONTACTS)
    at = np.searchsorted(motion.rows(LEDGER)["step"], rows["step"])
    force, branch = (np.stack([rows[part + axis] for axis in "xyz"], axis=1) for part in "fb")
    velocity = grain[at, :3] + np.cross(grain[at, 3:], branch)
    return np.bincount(at, np.sum(force * velocity, axis=1), len(grain))


def gaps(motion: Motion) -> tuple[float, float]:
    """How far the energy balance is open, over the energy at the start, at worst during the motion.

    Once with the work that the ledger states, and once with `contact_power` integrated by the trapezoidal rule.
    """
    table, dt = motion.rows(LEDGER), motion.numerics.dt
    energy, unit = table["kinetic"] + table["potential"], float(table["kinetic"][0])
    power = contact_power(motion)
    work = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2 * dt)])
    balance = energy - table["contact_work"]
    start = _energy_at_start(motion)
    return float(np.abs(balance - start).max()) / unit, float(np.ptp(energy - work)) / unit


def _energy_at_start(motion: Motion) -> float:
    grains: Scene = motion.scene
    overlap = static_overlap(grains, grains.grains.mass * G)
    return grains.grains.mass * (G * (D / 2 - overlap) + 0.5 * float(np.dot(KICK, KICK)))


KICK = (3e-4, 0.0, -3e-4)
"""Velocity [m/s] that presses and shears the resting contact, not hard enough to end it."""


def _cycle(law: str):
    def run(stand: Stand) -> Mapping[str, float]:
        coarse, fine = (gaps(_vibrating(stand, law, dt, KICK, 0.0)) for dt in (2 * DT, DT))
        orders = [math.log2(a / b) for a, b in zip(coarse, fine, strict=True)]
        return {
            "gap, ledger": fine[0],
            "|order - 2|, ledger": abs(orders[0] - 2),
            "gap, integrated power": fine[1],
            "|order - 2|, integrated power": abs(orders[1] - 2),
        }

    return run


def _impact(stand: Stand) -> Mapping[str, float]:
    """A grain that hits the floor obliquely and leaves it: all work is done, and the balance is exact."""
    errors = {}
    for law in LAWS:
        table = _vibrating(stand, law, 2 * DT, (0.3, 0.0, -0.3), 100.0).rows(LEDGER)
        energy = table["kinetic"] + table["potential"]
        lost = float(energy[0] - energy[-1])
        errors[law] = abs(lost + float(table["contact_work"][-1])) / lost
    return errors


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
]
