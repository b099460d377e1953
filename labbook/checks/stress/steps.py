"""Time steps up to and past the stable limit, and stiffnesses over six decades."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from labbook.backend.probes import Contacts, Ledger
from labbook.checks.stress.case import Ending, StressCase, within
from labbook.checks.stress.watch import follow, guard_error, sound
from labbook.checks.verify.bed import pile, slow_energy, wall_force_error
from labbook.checks.verify.case import limited
from labbook.checks.verify.materials import LAWS, D, G, scene
from labbook.checks.verify.platform import MemberStart, Platform
from labbook.filling.placing import place
from labbook.scene import Box, Scene
from labbook.scene.packing import Packing
from labbook.scene.timescales import largest_stable_step

COUNT = 80
SOFT = {"hertz-mindlin": {"shear_modulus": 1e7}, "linear": {"normal_stiffness": 200.0}}
BELOW = (0.1, 0.3, 0.6, 0.9, 1.0)
"""Parts of the largest stable step with which a shaken bed comes to rest."""
PAST = (10.0, 100.0, 1e4)
SHAKEN = 0.05
"""Root mean square [m/s] of each component of the velocities that shake a bed at rest."""


def _settled(platform: Platform, bed: Scene, dt: float) -> Packing:
    return sound(follow(platform, MemberStart(bed, dt, place(bed, "gas", 1)), 20, 1000)).end


def _shaken(settled_bed: Packing) -> Packing:
    kick = np.random.default_rng(5).normal(0, SHAKEN, settled_bed.x.shape)
    return replace(settled_bed, v=settled_bed.v + kick)


def _time_steps(platform: Platform) -> Iterator[Ending]:
    for law in LAWS:
        bed = scene(COUNT, LAWS[law](**SOFT[law]), Box(width=4 * D, depth=4 * D, height=60 * D), G).close()
        limit = largest_stable_step(bed)
        settled_bed = _settled(platform, bed, 0.5 * limit)
        for part in (*BELOW, *PAST):
            steps = max(200, round(1000 / part))  # the same time for all that are stable
            outcome = follow(platform, MemberStart(bed, part * limit, _shaken(settled_bed)), 10, steps)
            name = f"{law}, {part:g} of the largest stable step"
            if part > 1:
                yield guard_error(name, outcome)
                continue
            # of 0.13 m g d at first
            energy = slow_energy(bed, sound(outcome).end)
            yield within(platform, name, "kinetic energy of all but 5 %", energy, limited(1e-6, "m g d"))


def _stiffnesses(platform: Platform) -> Iterator[Ending]:
    """A pile whose grains lie in pockets falls by a hundredth of a diameter, and rests within 10 ms."""
    for law, (key, values) in STIFFNESSES.items():
        for value in values:
            bed, start = pile(LAWS[law](**{key: value}))
            dt = 0.5 * largest_stable_step(bed)
            contacts = Contacts(every=40)
            steps = max(1000, round(0.02 / dt / 40))
            outcome = follow(platform, MemberStart(bed, dt, start), 40, steps, [Ledger(), contacts])
            part = f"{law}, {key} = {value:g}"
            if value == values[0]:
                yield guard_error(part, outcome, ("overlap",))
                continue
            trajectory = sound(outcome)
            # a spring s = F/k_t loses up to a rounding a step, as if it slipped at s 2^-24/dt; its dashpot answers that
            # with 2 z (k_n/k_t)/(w dt) roundings of F, z the damping ratio, w dt = pi dt/t_c: some 90 a contact
            balance = limited(1e-6, roundings=200)
            yield within(platform, part, "|wall force - weight|", wall_force_error(trajectory, contacts), balance)
            yield within(platform, part, "kinetic energy", trajectory.status.kinetic, limited(1e-9, "m g d"))


STIFFNESSES = {
    "hertz-mindlin": ("shear_modulus", (1e2, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10)),
    "linear": ("normal_stiffness", (0.01, 5.0, 50.0, 5e2, 5e3, 5e4, 5e5, 5e6)),
}
"""Each law's key and values [Pa, N/m]; grains of the first cannot carry one another."""


CASES = [
    StressCase(
        name="time-step",
        attempt="a shaken bed at steps from 0.1 of the largest stable one up to it, and 10 to 10 000 times it",
        oracle="the bed comes to rest; far above the limit a guard reports it",
        run=_time_steps,
    ),
    StressCase(
        name="stiffness",
        attempt="a pile at rest, stiffness over six decades, and one too soft to carry itself",
        oracle="static balance: forces on the walls = weight; the overlap guard",
        run=_stiffnesses,
    ),
]
