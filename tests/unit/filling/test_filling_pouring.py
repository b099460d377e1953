"""Grains of a stream: how many enter and when, where they start, and in which order."""

# packings of these tests have ids, kinds and orientations
# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportOptionalOperand=false

import math

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial import KDTree

from labbook.filling import Inflow, PlacingError, Pouring, place
from labbook.scene import (
    BedTop,
    Box,
    ConicalSilo,
    Feed,
    HertzMindlin,
    Kind,
    Packing,
    Scene,
    Spheres,
    Spherocylinders,
    Uniform,
)
from labbook.scene.orientation import axes
from labbook.scene.stream import Stream

D, BEAT = 3e-3, 0.01
SILO = ConicalSilo(diameter=0.05, height=0.4, angle=0.6, orifice=0.012)
EQUAL = Spheres(diameter=D, density=2500, count=150)
GRADED = Spheres(diameter=D, density=2500, count=150, sizes=Uniform(kind="uniform", smallest=D / 2))
RODS = Spherocylinders(diameter=D, length=2.5 * D, density=2500, count=60)
MIXED = Spheres(
    diameter=D, density=2500, count=90, kinds=(Kind(name="a", share=2 / 3), Kind(name="b", share=1 / 3, diameter=2e-3))
)
LOW, HIGH = (-0.015, -0.015, 0.3), (0.015, 0.015, 0.35)


def scene(grains, **more) -> Scene:
    return Scene(grains=grains, contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25), container=SILO, **more)


def stream(rate: float, **more) -> Stream:
    return Stream(rate=rate, low=LOW, high=HIGH, velocity=(0.0, 0.0, -1.0), **more)


def poured(grains, flow: Stream, seed: int = 1) -> list[Packing]:
    """What enters, beat by beat; those that are there have fallen far away."""
    pouring = Pouring(scene(grains).close(), flow, seed, BEAT)
    entered, there = [pouring.first()], pouring.first()
    for beat in range(1, 10_000):
        if len(there) == grains.count:
            return entered
        away = Packing(there.x - (0, 0, 1.0), there.v, there.omega, there.q, there.ids, there.diameter, there.kind)
        new = pouring.returning(BedTop.of(away), beat)
        if new is not None:
            entered.append(new)
            there = joined(entered)
    raise AssertionError("it never ends")


def joined(parts: list[Packing]) -> Packing:
    names = ("x", "v", "omega", "q", "ids", "diameter", "kind")
    own = {name: [getattr(part, name) for part in parts] for name in names}
    return Packing(**{name: np.concatenate(some) for name, some in own.items() if some[0] is not None})


@pytest.mark.parametrize("grains", [EQUAL, GRADED, RODS])
def test_grains_enter_at_the_rate_within_the_region_and_touch_nothing(grains):
    mass = grains.count * grains.volume * 2500
    duration = 0.3
    entered = poured(grains, stream(mass / duration))
    every = joined(entered)
    assert np.array_equal(np.sort(every.ids), np.arange(grains.count))
    assert len(entered) == pytest.approx(duration / BEAT, rel=0.1), "sizes are drawn"
    assert np.array_equal(every.v, np.tile([0.0, 0.0, -1.0], (grains.count, 1)))
    radius = grains.radius if every.diameter is None else every.diameter / 2
    reach = np.broadcast_to(radius, grains.count)[:, None] + (
        0 if every.q is None else grains.half_length * np.abs(axes(every.q))
    )
    assert (every.x - reach >= np.array(LOW) - 1e-12).all()
    assert (every.x + reach <= np.array(HIGH) + 1e-12).all()
    if every.q is None:
        for part in entered:
            own = np.broadcast_to(grains.radius if part.diameter is None else part.diameter / 2, len(part))
            for i, j in KDTree(part.x).query_pairs(D):
                assert np.linalg.norm(part.x[i] - part.x[j]) >= own[i] + own[j]


def test_the_rate_is_that_of_the_mass():
    """After each beat as many have entered as the mass that is due allows, to a grain."""
    rate, mass = 0.02, EQUAL.mass
    counts = np.cumsum([len(part) for part in poured(EQUAL, stream(rate))])
    due = np.floor(rate * BEAT * np.arange(1, len(counts) + 1) / mass * (1 + 1e-9))
    assert np.array_equal(counts, np.minimum(due, EQUAL.count))


def test_batches_enter_at_once():
    rate, mass = 0.02, EQUAL.mass
    parts = poured(EQUAL, stream(rate, every=5 * BEAT))
    each = math.floor(rate * 5 * BEAT / mass)
    assert [len(part) for part in parts[:-1]] == pytest.approx([each] * (len(parts) - 1), abs=1)
    assert len(parts) == math.ceil(EQUAL.count / (rate * 5 * BEAT / mass))


def test_layers_enter_in_their_order():
    kinds = joined(poured(MIXED, stream(0.02, layers=("a", "b", "a")))).kind
    assert list(kinds) == [0] * 30 + [1] * 30 + [0] * 30


def test_beat_and_seed_decide_what_enters():
    one, same, other = (joined(poured(EQUAL, stream(0.02), seed)) for seed in (1, 1, 2))
    assert np.array_equal(one.x, same.x)
    assert np.array_equal(one.ids, same.ids)
    assert not np.array_equal(one.ids, other.ids)


@pytest.mark.parametrize(
    ("flow", "why"),
    [
        (Stream(rate=1.0, low=LOW, high=(0.015, 0.015, 0.301)), "narrower than a grain along z"),
        (Stream(rate=1.0, low=(0.015, 0.015, 0.0), high=(0.02, 0.02, 0.005)), "no grain finds a place"),
        (Stream(rate=1.0, low=(0.03, 0.03, 0.3), high=(0.04, 0.04, 0.35)), "narrower than a grain along x"),
        (stream(1.0, layers=("a",)), "no kind is called a"),
    ],
)
def test_a_stream_that_brings_nothing_is_refused(flow, why):
    with pytest.raises(PlacingError, match=why):
        Pouring(scene(EQUAL).close(), flow, 1, BEAT).first()


def test_an_empty_region_is_refused():
    with pytest.raises(ValidationError, match="the region is empty along y"):
        Stream(rate=1.0, low=LOW, high=(0.015, -0.02, 0.35))
    with pytest.raises(ValidationError, match="this key is missing"):
        Feed(kind="rate")
    with pytest.raises(ValidationError, match="use kind: rate"):
        Feed(kind="reinject", stream=stream(1.0))


@pytest.mark.slow
def test_grains_that_left_enter_again_at_the_rate():
    """While enough wait; what a beat could not bring is not made up for."""
    rate, mass = 0.02, EQUAL.mass
    silo = scene(EQUAL, feed=Feed(kind="rate", stream=stream(rate)))
    bed = place(silo.close(), "gas", 1)
    inflow = Inflow(silo, bed, 1, BEAT)
    assert inflow.returning(BedTop.of(bed), 3) is None, "nobody waits"
    few = bed.subset(np.arange(EQUAL.count) < 20)
    many = [inflow.returning(BedTop.of(few), beat) for beat in range(1, 101)]
    brought = sum(len(part) for part in many if part is not None)
    assert brought == pytest.approx(rate * 100 * BEAT / mass, abs=1)
    assert all((part.ids >= 20).all() for part in many if part is not None)


@pytest.mark.parametrize("grains", [MIXED, RODS])
def test_a_bed_is_stored_with_the_grains_that_have_still_to_enter(grains):
    """These come last, at places of their own; without them it is the same bed, and the stream brings just these."""
    pouring = Pouring(scene(grains).close(), stream(0.02), 1, BEAT)
    there = pouring.first()
    stored = pouring.with_waiting(there)
    assert stored.waiting is not None
    assert np.array_equal(np.sort(stored.ids), np.arange(grains.count))
    assert all(np.array_equal(stored.entered.arrays()[name], array) for name, array in there.arrays().items())
    assert len(np.unique(stored.x[stored.waiting], axis=0)) == grains.count - len(there)
    turned = stored.renumbered(np.argsort(stored.ids))
    assert set(turned.entered.ids) == set(there.ids)
    later = Pouring(scene(grains).close(), stream(0.02), 1, BEAT, turned, since=10.0)
    left = np.zeros(grains.count, bool)
    left[stored.ids[stored.waiting][:5]] = True
    entering = later.returning(BedTop.of(there), 1, left)
    assert entering is not None
    assert not np.isin(entering.ids, there.ids).any()
    assert not left[entering.ids].any()
    assert np.array_equal(later.order, pouring.order)
    if stored.kind is not None:
        assert np.array_equal(entering.kind, turned.kind[entering.ids])


def test_a_stream_at_a_periodic_side_sees_the_bed_across_it():
    """Grains just within one side fill the height of the region, which ends at the other."""
    period = 6 * D
    silo = Box(width=6 * D, depth=period, height=60 * D, periodic="y")
    flow = stream(50.0).model_copy(update={"low": (-2 * D, 0.2 * period, 20 * D), "high": (2 * D, period / 2, 24 * D)})
    closed = scene(EQUAL).model_copy(update={"container": silo}).close()
    x, z = (of.ravel() for of in np.meshgrid(D * np.arange(-2, 3), D * np.arange(20, 25)))
    bed = np.column_stack([x, np.full(len(x), -period / 2 + 0.1 * D), z])
    there = Packing(bed, np.zeros_like(bed), np.zeros_like(bed), ids=np.arange(len(bed)))
    entered = Pouring(closed, flow, 1, BEAT).returning(BedTop.of(there), 1)
    assert len(entered) > 3
    branches = entered.x[:, None] - bed
    branches[..., 1] -= period * np.round(branches[..., 1] / period)
    assert np.linalg.norm(branches, axis=2).min() >= D
    assert np.abs(entered.x[:, 1]).max() > period / 2 - D, "some are near the side"
