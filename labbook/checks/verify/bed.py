"""Grains at rest: walls carry their weight, and nothing drifts."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from labbook.backend.probes import Contacts, Ledger, Sample
from labbook.checks.verify.case import Case, Criterion, limited
from labbook.checks.verify.collision import STUDY_STEP
from labbook.checks.verify.materials import LAWS, D, G, floor, hertz, scene
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory, grains_at
from labbook.checks.verify.rolling import static_overlap
from labbook.filling.bed import fastest_points
from labbook.filling.placing import place
from labbook.scene import Bodies, Box, Primitives, Scene, WedgeHopper
from labbook.scene.contact import ContactLaw
from labbook.scene.packing import Packing

DT = 8e-6
"""A tenth of the Rayleigh time of grains with a shear modulus of 1e7 Pa."""
SOFT = {"shear_modulus": 1e7}
BEDS = (1, 2, 3)
"""Seeds of the beds that have to come to rest."""
FORCE, ENERGY = "|wall force - weight|", "kinetic energy of all but 5 %"
Entry = TypeVar("Entry")


def _beds() -> list[Scene]:
    return [
        scene(
            100, hertz(**SOFT), WedgeHopper(width=10 * D, height=60 * D, thickness=1.01 * D, angle=a, orifice=4 * D), G
        ).close()
        for a in (math.pi / 2, math.radians(60))
    ]


def _sinks_in(platform: Platform) -> Mapping[str, float]:
    """Drop a grain at its static overlap's height, at the study's step: it comes to rest at that overlap."""
    errors = {}
    for law, material in LAWS.items():
        scene_at_rest = scene(1, material(), Primitives(parts=(floor(),)), G)
        expected = static_overlap(scene_at_rest, scene_at_rest.grains.mass * G)
        end = platform.run(MemberStart(scene_at_rest, STUDY_STEP, grains_at([0, 0, D / 2 + expected])), 40).end
        errors[law] = abs((D / 2 - float(end.x[0, 2])) / expected - 1)
    return errors


def borne(platform: Platform, bed: Scene, dt: float, beats: int) -> Mapping[str, float]:
    """Measure wall forces and kinetic energy of a bed at rest, as medians over three seeds.

    Now and then a bed is not at rest. A grain held by rolling resistance alone creeps under its limiter, at up to
    30 g dt (`rest-on-incline`). It may roll off at any time and move the grains that lean on it. Which bed has such a
    grain depends on the last bit, and so on the processor; hence the median.

    Args:
        stand: The platform.
        bed: The closed scene.
        dt: Time step [s].
        beats: Number of beats of 1000 steps.

    Returns:
        By name, the error of the force on the walls [weight], and `slow_energy` [m g d].
    """
    errors, energies, contacts = [], [], Contacts(every=beats)
    for seed in BEDS:
        trajectory = platform.run(MemberStart(bed, dt, place(bed, "gas", seed)), beats, probes=(contacts,))
        errors.append(wall_force_error(trajectory, contacts))
        energies.append(slow_energy(bed, trajectory.end))
    return {FORCE: float(np.median(errors)), ENERGY: float(np.median(energies))}


def slow_energy(bed: Scene, end: Packing) -> float:
    """Mean kinetic energy [m g d] of all but the fastest twentieth of the grains.

    Each grain counts as if its centre moved as fast as its fastest point.
    """
    fastest = np.sort(fastest_points(bed.grains, end))
    slow = fastest[: len(fastest) * 19 // 20]
    return float(np.mean(slow**2)) / (2 * bed.gravity * bed.grains.diameter)


def wall_force_error(trajectory: Trajectory, contacts: Contacts) -> float:
    """Distance of the sum of wall forces from the weight of the grains, over that weight, at the last reading."""
    rows = trajectory.rows(contacts)
    walls = (rows["wall"] >= 0) & (rows["step"] == rows["step"].max())
    force = np.array([rows[axis][walls].sum() for axis in ("fx", "fy", "fz")])
    weight = float(Bodies.of(trajectory.scene.grains, trajectory.end).mass.sum()) * trajectory.scene.gravity
    return float(np.linalg.norm(force - [0, 0, weight])) / weight


def in_each(by_bed: Mapping[str, Mapping[str, Entry]]) -> Mapping[str, Entry]:
    """Flatten a mapping by bed and name to one by "name, bed"."""
    return {f"{name}, {bed}": error for bed, errors in by_bed.items() for name, error in errors.items()}


def at_rest(*beds: str) -> Mapping[str, Criterion]:
    """Limits on force and energy for beds of these names."""
    limits = {FORCE: limited(1e-6), ENERGY: limited(1e-9, "m g d")}
    return in_each({bed: limits for bed in beds})


def _carries(platform: Platform) -> Mapping[str, float]:
    return in_each(
        {name: borne(platform, bed, DT, 200) for bed, name in zip(_beds(), ("flat", "inclined"), strict=True)}
    )


def pile(law: ContactLaw) -> tuple[Scene, Packing]:
    """Fourteen grains stacked like cannonballs in a narrow box: layers of four and of one, with small gaps."""
    box = scene(14, law, Box(width=2.01 * D, depth=2.01 * D, height=20 * D), G)
    corners = [(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)]
    layers = [corners if k % 2 == 0 else [(0.0, 0.0)] for k in range(5)]
    x = [(a * D, b * D, D / 2 + k * 0.72 * D) for k, layer in enumerate(layers) for a, b in layer]
    return box, grains_at(x)


def _stays(platform: Platform) -> Mapping[str, float]:
    """A pile in a narrow box: a million steps after it settled.

    Every grain lies in a pocket: the torques of `cdt` hold none of them. A grain that leans and is held by rolling
    resistance alone creeps under its limiter, at up to 30 g dt (`rest-on-incline`), in any precision: random piles have
    such grains now and then. Rolling springs, `epsd`, hold them (`rolling-spring-rests`, `rolling-spring-pyramid`).
    """
    bed, start = pile(hertz(**SOFT))
    rng = np.random.default_rng(1)
    settled = platform.run(MemberStart(bed, DT, replace(start, v=rng.normal(0, 0.01, start.x.shape))), 200)
    probes = (Ledger(every=10), Sample(fields=("x",), every=100))
    trajectory = platform.run(MemberStart(bed, DT, settled.end), 1000, probes=probes)
    totals, x = trajectory.rows(probes[0]), trajectory.by_beat(probes[1], "xyz")
    unit = bed.grains.count * bed.grains.mass * G * D
    energy = totals["potential"] / unit
    return {
        "largest kinetic energy": float(totals["kinetic"].max()) / unit,
        "change of potential energy": float(np.ptp(energy)),
        "drift": float(np.abs(x[-1] - x[0]).max() / D),
    }


CASES = [
    Case(
        name="static-overlap",
        statement="the overlap of a grain at rest on a floor balances its weight, for any damping",
        source="contact laws at rest",
        measures={law: limited(1e-8, roundings=16) for law in LAWS},
        run=_sinks_in,
    ),
    Case(
        name="resting-bed",
        statement="a bed comes to rest, and the wall forces add up to its weight",
        source="equilibrium",
        measures=at_rest("flat", "inclined"),
        run=_carries,
    ),
    Case(
        name="resting-pile",
        statement="a pile with grains in pockets stays at rest for a million steps; other piles creep with cdt",
        source="equilibrium",
        measures={
            "largest kinetic energy": limited(1e-9, "m g d"),
            "change of potential energy": limited(1e-6, "m g d"),
            # springs, below 6e-4 d, lose up to a rounding at each of a million steps
            "drift": limited(1e-6, "d", roundings=600),
        },
        run=_stays,
        slow=True,
    ),
]
