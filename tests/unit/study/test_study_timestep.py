"""The time step that a study asks for."""

import json
import math
import re
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace

import pytest

from labbook.scene import (
    CylinderSilo,
    HertzMindlin,
    LinearSpringDashpot,
    Scene,
    Spheres,
    Spherocylinders,
    SurfaceChange,
    WedgeHopper,
)
from labbook.scene.timescales import collision, largest_stable_step, rayleigh
from labbook.study.timestep import TimeStepError, resolve

GRAINS = Spheres(diameter=0.003, density=2500.0, count=3000)
HOPPER = WedgeHopper(width=0.1, height=0.4, thickness=0.00303, orifice=0.03)
HERTZ = Scene(grains=GRAINS, contact=HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25), container=HOPPER)
LINEAR = Scene(grains=GRAINS, contact=LinearSpringDashpot(normal_stiffness=1e4), container=HOPPER)


@pytest.mark.parametrize(
    ("stated", "scene", "step"),
    [
        ("2.5 us", HERTZ, 2.5e-6),
        ("0.1 rayleigh", HERTZ, 0.1 * rayleigh(HERTZ)),
        ("0.1*rayleigh", HERTZ, 0.1 * rayleigh(HERTZ)),
        ("1/50 collision", HERTZ, 0.02 * collision(HERTZ)),
        ("2 % collision", LINEAR, 0.02 * collision(LINEAR)),
        (None, HERTZ, 0.1 * rayleigh(HERTZ)),
        (None, LINEAR, 0.02 * collision(LINEAR)),
    ],
)
def test_steps(stated, scene, step):
    assert resolve(stated, scene, 1.0) == pytest.approx(step, rel=1e-5)


def test_parts_of_a_time_scale_have_six_digits():
    step = resolve("0.1 rayleigh", HERTZ, 1.0)
    assert step == float(f"{step:.6g}")


def test_softer_grains_take_longer_steps():
    assert resolve(None, HERTZ, 0.01) == pytest.approx(10 * resolve(None, HERTZ, 1.0), rel=1e-5)
    assert resolve(None, LINEAR, 0.25) == pytest.approx(2 * resolve(None, LINEAR, 1.0), rel=1e-5)


@pytest.mark.parametrize(
    ("stated", "scene", "reason"),
    [
        ("0.1 raleigh", HERTZ, "no time scale is called raleigh"),
        ("0.1 rayleigh", LINEAR, "laws by Hertz"),
        ("0.1 mm", HERTZ, "a quantity in s"),
        ("x collision", HERTZ, "not a quantity"),
        ("1 collision", HERTZ, "do not come to rest"),
        ("1 s", HERTZ, "do not come to rest"),
        ("-1 us", HERTZ, "not between 0"),
        ("0 collision", HERTZ, "not between 0"),
        (2.5e-6, HERTZ, "unit is missing"),
        (True, HERTZ, "a time is needed"),
    ],
)
def test_refused_steps(stated, scene, reason):
    with pytest.raises(TimeStepError, match=reason) as caught:
        resolve(stated, scene, 1.0)
    assert caught.value.remedy


@pytest.mark.parametrize("restitution", [0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("scene", [HERTZ, LINEAR])
def test_a_refused_step_names_one_that_is_taken(scene, restitution):
    damped = scene.model_copy(update={"contact": scene.contact.model_copy(update={"restitution": restitution})})
    with pytest.raises(TimeStepError) as caught:
        resolve("1 s", damped, 1.0)
    found = re.fullmatch(r"use at most (\S+ collision), or leave numerics.dt out", caught.value.remedy)
    assert found
    assert resolve(found[1], damped, 1.0) > 0.85 * largest_stable_step(damped)


def test_the_default_stays_below_what_heavy_damping_allows():
    heavy = LINEAR.model_copy(update={"contact": LINEAR.contact.model_copy(update={"restitution": 0.05})})
    assert resolve(None, heavy, 1.0) == pytest.approx(0.75 * largest_stable_step(heavy), rel=1e-5)
    assert resolve(None, heavy, 1.0) < 0.02 * collision(heavy)


def test_the_largest_step_counts_the_heaviest_damping_of_any_contact():
    heavy = LINEAR.model_copy(update={"walls": {"left": SurfaceChange(restitution=0.1)}})
    grains = LINEAR.model_copy(update={"contact": LINEAR.contact.model_copy(update={"restitution": 0.1})})
    assert largest_stable_step(heavy) == largest_stable_step(grains) < largest_stable_step(LINEAR) / 5


def test_without_damping_the_limit_is_that_of_the_springs():
    # a bed's fastest mode is some 1.3 times as fast as one contact, which is stable up to w = 2
    assert math.pi * largest_stable_step(LINEAR) / collision(LINEAR) == pytest.approx(1.8**-0.5)


def measured():
    """Beds that were followed on a GPU at fourteen steps each (benchmarks/step_limit.py), by all but the step."""
    path = Path(__file__).parents[3] / "benchmarks" / "results" / "2026-11-22-step-limit-h100.json"
    results = json.loads(path.read_text())
    series = defaultdict(list)
    for row in results["beds"]:
        bed = SimpleNamespace(**dict(zip(results["columns"], row, strict=True)))
        series[bed.law, bed.damping, bed.restitution, bed.stiffness, bed.length, bed.grains].append(bed)
    return series


def scene_of(bed) -> Scene:
    shared = {"friction": 0.5, "restitution": bed.restitution, "damping": bed.damping}
    if bed.law == "linear":
        law = LinearSpringDashpot(normal_stiffness=bed.stiffness, **shared)
    else:
        law = HertzMindlin(shear_modulus=bed.stiffness, poisson_ratio=0.25, **shared)
    grains = Spheres(diameter=0.003, density=2500.0, count=bed.grains)
    if bed.length > 1:
        grains = Spherocylinders(diameter=0.003, length=bed.length * 0.003, density=2500.0, count=bed.grains)
    return Scene(grains=grains, contact=law, container=CylinderSilo(diameter=0.04, height=1, orifice=0.02))


def test_steps_are_refused_where_measured_beds_fail_and_taken_where_they_rest():
    """A bed at a step that is taken must not fail, nor keep more energy than a few rolling grains have (1e-4 m g d);
    of beds at one and a half times the limit and beyond, nine of ten must, or the limit would be too low.

    Left out: the softest springs under the tallest rods, whose overlaps fail at any step."""
    taken, beyond = [], []
    for (law, *_, stiffness, length, _), beds in measured().items():
        if (law, stiffness, length) == ("linear", 200.0, 4.0):
            continue
        limit = largest_stable_step(scene_of(beds[0]))
        for bed in beds:
            failed = bed.outcome == "failed" or bed.kinetic > 1e-4
            if bed.outcome == "unfinished":
                continue
            if bed.dt <= limit:
                taken.append((failed, bed))
            elif bed.dt > 1.5 * limit and deep(bed):
                beyond.append(failed)
    assert len(taken) > 1500
    assert not [bed for failed, bed in taken if failed]
    assert len(beyond) > 300
    assert sum(beyond) > 0.9 * len(beyond)


def deep(bed) -> bool:
    """Whether overlaps in the bed are large: shallow beds of hard grains fail later."""
    return bed.grains != 300 and (bed.law == "linear" or bed.stiffness == 1e7)
