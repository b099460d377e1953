"""Totals of a member: energies, momenta, and the work of contacts."""

import math

import numpy as np

from labbook.backend import Status
from labbook.scene import Bodies, Grains, Scene
from labbook_dem.rotation import spins


def kinetic(grains: Grains | Bodies, v: np.ndarray, m: np.ndarray, q: np.ndarray | None = None) -> float:
    """Kinetic energy [J] of velocities v [m/s] and reduced angular momenta m [rad/s] (of spheres: spins).

    Args:
        grains: properties of all grains, or of each.
        v: velocities, shape [n, 3].
        m: reduced angular momenta, shape [n, 3].
        q: orientations of rods (`labbook_dem.rotation`), whose rotational energy is I_t m.omega / 2.
    """
    if isinstance(grains, Bodies):
        return 0.5 * float(grains.mass @ np.sum(v**2, axis=1) + grains.inertia @ np.sum(m**2, axis=1))
    return 0.5 * grains.mass * float(np.sum(v**2)) + 0.5 * grains.inertia * float(np.sum(m * spins(grains, m, q)))


def energy_scale(scene: Scene) -> float:
    """Unit m g d [J] of kinetic energies per grain, m the mean mass; m d^2/s^2 without gravity."""
    d = scene.grains.diameter
    return scene.grains.mass * (scene.gravity * d or d**2)


def status(scene: Scene, step: int, time: float, grains: int, energy: float, deepest: float, fastest: float) -> Status:
    """Status of a member.

    Args:
        scene: scene.
        step: steps taken.
        time: time [s].
        grains: present grains.
        energy: kinetic energy [J].
        deepest: largest overlap [m] so far; infinite if not recorded.
        fastest: largest speed [m/s] so far; infinite if not recorded.
    """
    overlap = deepest / scene.grains.finest if math.isfinite(deepest) else None
    kinetic_per_grain = energy / max(grains, 1) / energy_scale(scene)
    return Status(step, time, grains, kinetic_per_grain, overlap, fastest if math.isfinite(fastest) else None)


def _sum(weight: float | np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sum over grains of a weight, one for all or one each, times `values`, shape [n, ...]; shape [...]."""
    return weight @ values if isinstance(weight, np.ndarray) else weight * values.sum(axis=0)


def totals(
    scene: Scene, x: np.ndarray, v: np.ndarray, m: np.ndarray, v_half: np.ndarray, m_half: np.ndarray,
    since_half: float, work: float, q: np.ndarray | None = None, bodies: Bodies | None = None,
) -> dict[str, float]:  # fmt: skip
    """Energies [J], mass [kg], momentum [kg m/s] and angular momentum [kg m^2/s] about the origin.

    x, v, m, q are at the whole step; v_half, m_half half a step before, `since_half` [s] ago (0 at the start); m as in
    `kinetic`. work: of all kicks so far; the work of the last half kick is its gain of kinetic energy less the work of
    gravity. bodies: properties of each grain, in a mixture.
    """
    grains = bodies or scene.grains
    mass, weight = grains.mass, grains.mass * scene.gravity
    energy = kinetic(grains, v, m, q)
    kinetic_gain = energy - kinetic(grains, v_half, m_half, q)  # the drift of a rod conserves m.a, and so its energy
    gravity_work = -0.5 * float(_sum(weight * since_half, v[:, 2] + v_half[:, 2]))
    momentum = _sum(mass, v)
    angular = _sum(mass, np.cross(x, v)) + _sum(grains.inertia, m)
    return {
        "kinetic": energy,
        # fsum: the energy of a bed is a large sum of which small changes count, whatever the order of the grains
        "potential": float(weight) * math.fsum(x[:, 2]) if bodies is None else math.fsum(weight * x[:, 2]),
        "contact_work": work + kinetic_gain - gravity_work,
        "mass": scene.grains.mass * len(x) if bodies is None else math.fsum(bodies.mass),
        **dict(zip(("px", "py", "pz"), momentum.tolist(), strict=True)),
        **dict(zip(("lx", "ly", "lz"), angular.tolist(), strict=True)),
    }


def contact_power(
    scene: Scene, ids: np.ndarray, radius: np.ndarray, x: np.ndarray, v: np.ndarray, w: np.ndarray,
    contacts: np.ndarray, time: float = 0.0,
) -> dict[str, float]:  # fmt: skip
    """Powers [W] and half the sum of normal force times overlap [J] in the contacts of spheres.

    `normal_power` and `tangential_power` are -f.u of both parts of the force, where u is the velocity of one surface
    relative to the other at the contact point. The contact lies where `labbook_dem.spheres` has it, so that kinetic +
    potential energy changes by -(normal_power + tangential_power) + wall_power, but for torques of rolling friction.

    Args:
        scene: the grains and the walls with their motion.
        ids: of the grains, shape [n].
        radius: of the grains [m], shape [n].
        x: positions [m], shape [n, 3].
        v: velocities [m/s], shape [n, 3].
        w: angular velocities [rad/s], shape [n, 3].
        contacts: rows of the probe `Contacts`: i, j, wall, force on i [N], branch vector [m], shape [k, 9].
        time: at which parts that move are looked at [s].
    """
    # Contacts with walls have j = -1: the row they get is any, and `of_pair` masks it below.
    order = np.argsort(ids)
    wall, force, branch = contacts[:, 2].astype(np.int64), contacts[:, 3:6], contacts[:, 6:9]
    i, j = (order[np.searchsorted(ids, contacts[:, side], sorter=order).clip(max=len(ids) - 1)] for side in (0, 1))
    of_pair = wall < 0
    r = np.linalg.norm(branch, axis=1)
    unit_branch = branch / r[:, None]
    lever = np.where(of_pair, (r**2 + radius[i] ** 2 - radius[j] ** 2) / (2 * r), r)
    point = unit_branch * lever[:, None]
    velocity_j = v[j] + np.cross(w[j], point - branch)
    wall_velocity = np.zeros_like(force)
    for number, surface in enumerate(scene.container.walls()):
        at_surface = wall == number
        at, motion = x[i[at_surface]] + branch[at_surface], surface.motion
        wall_velocity[at_surface] = np.asarray(motion.velocity) + np.cross([0.0, 0.0, motion.spin], at)
        if surface.is_posed:
            pose = surface.poses(np.array([time]))
            wall_velocity[at_surface] += pose.velocity[0] + np.cross(pose.spin[0], at)
    relative = v[i] + np.cross(w[i], point) - np.where(of_pair[:, None], velocity_j, wall_velocity)
    normal_force = -np.sum(force * unit_branch, axis=1)
    total = -np.sum(force * relative, axis=1)
    normal = normal_force * np.sum(unit_branch * relative, axis=1)
    overlap = radius[i] - r + np.where(of_pair, radius[j], 0.0)
    return {
        "normal_power": math.fsum(normal),
        "tangential_power": math.fsum(total - normal),
        "wall_power": math.fsum(np.sum(force * wall_velocity, axis=1)),
        "elastic": 0.5 * math.fsum(normal_force * overlap),
    }
