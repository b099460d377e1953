"""An elastic, frictionless gas in a box keeps its energy, with the order of the integrator."""

import math
from collections.abc import Mapping

import numpy as np

from labbook.backend.probes import Contacts, Ledger
from labbook.checks.verify.case import Case, Criterion, limited
from labbook.checks.verify.collision import duration
from labbook.checks.verify.materials import LAWS, D, room, scene
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory
from labbook.scene import HertzMindlin, LinearSpringDashpot, Scene
from labbook.scene.packing import Packing

COUNT = 32
SIDE = 6 * D
SPEED = 0.1
"""Root mean square of each velocity component [m/s]."""
SOFT = {"hertz-mindlin": {"shear_modulus": 1e5}, "linear": {"normal_stiffness": 30.0}}
"""Soft enough that 50 collision times see each grain collide a few times."""
COLLISION_TIMES = 50


def gas(law: str) -> tuple[Scene, Packing]:
    """Grains on a cubic lattice in a box, with Gaussian velocities."""
    material = LAWS[law](friction=0, rolling_friction=0, restitution=1, **SOFT[law])
    rng = np.random.default_rng(3)
    sites = np.stack(np.meshgrid(*[np.arange(4)] * 3), -1).reshape(-1, 3)
    sites = sites[rng.permutation(len(sites))[:COUNT]]
    x = (sites - 1.5) * 1.4 * D + [0, 0, SIDE / 2]
    v = rng.normal(0, SPEED, x.shape)
    return scene(COUNT, material, room(SIDE)), Packing(x=x, v=v, omega=np.zeros_like(x))


def elastic_energy(scene: Scene, overlap: np.ndarray, at_wall: np.ndarray) -> np.ndarray:
    """Energy [J] stored in each contact: k_n delta^2 / 2, or (8/15) E* sqrt(R*) delta^{5/2} after Hertz."""
    law, radius = scene.contact, scene.grains.radius
    if isinstance(law, HertzMindlin):
        effective = np.where(at_wall, radius, radius / 2)
        return 8 / 15 * law.effective_modulus * np.sqrt(effective) * overlap**2.5
    assert isinstance(law, LinearSpringDashpot)
    return 0.5 * law.normal_stiffness * overlap**2


def energies(trajectory: Trajectory, ledger: Ledger, contacts: Contacts) -> np.ndarray:
    """Kinetic plus elastic energy [J] at each reading; the elastic part from overlaps alone."""
    totals, rows = trajectory.rows(ledger), trajectory.rows(contacts)
    at_wall = rows["wall"] >= 0
    branch = np.sqrt(rows["bx"] ** 2 + rows["by"] ** 2 + rows["bz"] ** 2)
    overlap = np.where(at_wall, trajectory.scene.grains.radius, trajectory.scene.grains.diameter) - branch
    stored = elastic_energy(trajectory.scene, overlap, at_wall)
    index = np.searchsorted(totals["step"], rows["step"])
    return totals["kinetic"] + np.bincount(index, stored, len(totals["step"]))


def energy_drift(platform: Platform, law: str, steps_per_collision: int) -> tuple[float, float]:
    """Largest relative change of energy, and mean number of contacts at a reading."""
    soft, start = gas(law)
    dt = duration(soft, SPEED * math.sqrt(2)) / steps_per_collision
    probes = (Ledger(), Contacts())
    beats = 500
    steps = COLLISION_TIMES * steps_per_collision // beats
    trajectory = platform.run(MemberStart(soft, dt, start), beats, steps, probes)
    energy = energies(trajectory, *probes)
    initial = 0.5 * soft.grains.mass * float(np.sum(start.v**2))
    return float(np.abs(energy / initial - 1).max()), len(trajectory.rows(probes[1])["step"]) / beats


def _gas(law: str):
    def run(platform: Platform) -> Mapping[str, float]:
        finest, busy = energy_drift(platform, law, 2000)
        coarse, _ = energy_drift(platform, law, 500)
        return {
            "largest change of energy": finest,
            "|order in dt - 2|": abs(math.log(coarse / finest, 4) - 2),
            "contacts at a time": busy,
        }

    return run


CASES = [
    Case(
        name=f"gas-energy-{law}",
        statement="an elastic frictionless gas in a box, 1e5 steps at t_c/2000: kinetic + elastic energy stays",
        source=source,
        measures={
            "largest change of energy": limited(1e-6, steps=1e5),
            # the sum of 1e5 roundings of velocities hides the error in dt
            "|order in dt - 2|": limited(order, steps=math.inf),
            "contacts at a time": Criterion({}),
        },
        run=_gas(law),
    )
    # the linear force has a kink at the touch, which adds a random part to the smooth second-order error
    for law, source, order in (
        ("hertz-mindlin", "elastic energy after Hertz", 0.05),
        ("linear", "elastic energy of springs", 0.5),
    )
]
