"""Composition of the outflow: of beds made by hand, whose segregation is known, and of random ones."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chisquare

from labbook.backend.numerics import Numerics
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.composition import (
    OutflowShares,
    _shuffled_counts,
    bin_edges,
    lacey_index,
    outflow_shares,
    permutation_p,
    segregation,
)
from labbook.measure.trajectories import Trajectories
from labbook.scene import Bodies, ConicalSilo, HertzMindlin, Kind, Packing, Scene, Spheres
from labbook.scene.sizes import Uniform
from labbook.study.schema import Window

MEASURE = MEASURES["composition"]
D, N, RATE, WINDOW = 3e-3, 4000, 1000.0, Window(start=0.1, end=0.6)
CONE = ConicalSilo(diameter=0.06, height=0.3, angle=0.5, orifice=0.02)
KINDS = (Kind(name="glass", share=0.25), Kind(name="steel", share=0.75, diameter=2e-3, density=7800))


def run_of(kind: np.ndarray, order: np.ndarray, outcome="finished", left: int = N, **grains) -> RunData:
    """Grain order[k] of these kinds leaves as number k, RATE a second; rows and ids are in random order."""
    rng = np.random.default_rng(7)
    spheres = Spheres(diameter=D, density=2500, count=N, **(grains or {"kinds": KINDS}))
    ids = rng.permutation(N)
    diameter = np.where(kind == 0, D, 2e-3)
    x = rng.uniform(0, 0.05, (N, 3))
    still = np.zeros((N, 3))
    start = Packing(x=x, v=still, omega=still, ids=ids, diameter=diameter, kind=kind if spheres.kinds else None)
    time = np.arange(1, left + 1) / RATE
    shuffled = rng.permutation(left)
    rows = {"time": time[shuffled], "id": ids[order[:left]][shuffled]}
    scene = Scene(
        grains=spheres, contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25), container=CONE
    )  # fmt: skip
    return RunData(scene, Numerics(dt=1e-5), 1, start, outcome, 5.0, {"crossing": rows})


def numbers(run: RunData, window=WINDOW):
    return {one.quantity: one for one in MEASURE.evaluate(run, window).numbers}


RANDOM = np.random.default_rng(3).permutation(np.arange(N) % 4 > 0).astype(np.int64)
"""A quarter of the grains are of kind 0."""


def test_a_crossing_has_kind_radius_and_mass():
    run = run_of(RANDOM, np.arange(N))
    rows, kind = run.rows("crossing"), RANDOM[run.start.rows(run.tables["crossing"]["id"])]
    assert np.array_equal(rows["kind"], np.where(kind, "steel", "glass"))
    assert rows["radius"] == pytest.approx(np.where(kind, 1e-3, 1.5e-3))
    assert rows["mass"] == pytest.approx(math.pi / 6 * np.where(kind, 7800 * 2e-3**3, 2500 * D**3))
    equal = replace(run, scene=run.scene.model_copy(update={"grains": Spheres(diameter=D, density=2500, count=N)}))
    assert equal.rows("crossing").keys() == {"time", "id"}


def test_trajectories_have_kind_and_mass():
    run = run_of(RANDOM, np.arange(N))
    rows = {"time": np.repeat([0.0, 0.1], N), "id": np.tile(np.arange(N), 2)}
    rows |= dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), np.zeros(2 * N))
    paths = Trajectories.of(replace(run, recorded=lambda: rows))
    assert paths is not None
    assert paths.kind is not None
    kind = RANDOM[run.start.rows(paths.ids)]
    assert np.array_equal(paths.kind, np.where(kind, "steel", "glass"))
    assert paths.mass == pytest.approx(math.pi / 6 * np.where(kind, 7800 * 2e-3**3, 2500 * D**3))


def test_rates_of_the_kinds_add_up_to_the_flow_rate():
    found = numbers(run_of(RANDOM, np.arange(N)))
    (whole,) = (
        one for one in MEASURES["flow_rate"].evaluate(run_of(RANDOM, np.arange(N)), WINDOW).numbers[:1]
    )  # fmt: skip
    rates = [found[f"flow_rate_of_{name}"] for name in ("glass", "steel")]
    assert sum(one.value for one in rates) == pytest.approx(whole.value, rel=1e-12)
    assert {one.unit for one in rates} == {"kg/s"}
    # a quarter of 1000 grains a second, to three errors of the binomial law over the 2000 grains of the window
    glass, mass = 0.25 * RATE * 2500 * math.pi / 6 * D**3, math.sqrt(0.75 / 0.25 / 2000)
    assert rates[0].value == pytest.approx(glass, rel=3 * mass)
    assert 0 < rates[0].error < 3 * mass * glass


def test_a_clogged_run_and_a_rare_kind():
    clogged = run_of(RANDOM, np.arange(N), outcome="clogged")
    assert {"flow_rate_of_glass_flowing", "flow_rate_of_steel_flowing"} <= numbers(clogged).keys()
    rare = numbers(run_of((np.arange(N) >= 50).astype(np.int64), np.arange(N)))
    assert math.isnan(rare["flow_rate_of_glass"].value)
    assert rare["flow_rate_of_glass"].note == "too few grains: fewer than 60 of glass in the window"
    declared = {one.name for one in MEASURE.quantities(clogged.scene)}
    assert numbers(clogged).keys() | rare.keys() <= declared


@pytest.mark.parametrize("total", [400, 799, 4000, 4321, 100_000])
def test_bins_hold_all_grains_of_a_full_discharge(total):
    edges = bin_edges(total, total)
    assert (edges[0], edges[-1]) == (0, total)
    assert len(edges) <= 21
    assert np.diff(edges).min() >= 400
    assert bin_edges(total, total - 1)[-1] < total, "the last bin is not complete"


def test_the_outflow_of_a_full_discharge_has_the_composition_of_the_bed():
    """F4: exactly, to rounding; each grain is in one bin."""
    run = run_of(RANDOM, np.argsort(RANDOM, kind="stable"))
    shares = OutflowShares.of(MEASURE.evaluate(run, WINDOW))
    assert shares is not None
    mass = Bodies.of(run.scene.grains, run.start).mass
    own = np.array([mass[k == RANDOM].sum() for k in (0, 1)])
    assert shares.mass.sum(axis=1) == pytest.approx(own, rel=1e-12)
    assert shares.initial == pytest.approx(own / mass.sum(), rel=1e-12)
    assert shares.fraction[-1] == pytest.approx(1, rel=1e-12)
    assert np.diff(shares.fraction) @ shares.share.T == pytest.approx(shares.initial, rel=1e-12)


def test_the_counting_error_is_that_of_the_binomial_law():
    group = np.random.default_rng(5).integers(0, 2, 2000)
    shares = outflow_shares(np.full(2000, 2.5), group, np.arange(2000), 2)
    x = group.reshape(5, 400).mean(axis=1)
    assert shares.share[1] == pytest.approx(x)
    assert shares.error == pytest.approx(np.tile(np.sqrt(x * (1 - x) / 400), (2, 1)))


def test_the_index_of_a_separated_bed():
    """All glass leaves first: x is 1 in a quarter of ten bins, so that SI^2 is their variance over x_0^2, known here in
    closed form for equal masses; p is the smallest that 1000 permutations give."""
    group = np.repeat([0, 1], [1000, 3000])
    mass = np.ones(N)
    shares = outflow_shares(mass, group, np.arange(N), 2)
    x = np.clip(2.5 - np.arange(10), 0, 1)
    noise = 0.25 * 0.75 * N / (N - 1) / 400
    expected = (x.var(ddof=1) - noise) / np.array([0.25, 0.75]) ** 2
    assert segregation(mass, group, shares, 400) == pytest.approx(expected)
    assert permutation_p(mass, group, np.arange(N), 2, np.random.default_rng(1), 200) == 1 / 201


@pytest.mark.slow
def test_a_random_bed_has_no_segregation_and_a_uniform_p():
    """F1: 200 beds of two kinds of several sizes, whose labels are permuted. SI^2 is 0 to three errors of the mean; p
    in ten classes."""
    rng = np.random.default_rng(11)
    squares, p = [], []
    for _ in range(200):
        group = rng.permutation(np.arange(2000) % 4 > 0).astype(np.int64)
        mass, left = np.where(group, 2.0, 3.0) * rng.uniform(0.8, 1.2, 2000), rng.permutation(2000)[:1700]
        squares.append(segregation(mass, group, outflow_shares(mass, group, left, 2), 400)[0])
        p.append(permutation_p(mass, group, left, 2, rng, 49))
    assert abs(np.mean(squares)) < 3 * np.std(squares) / math.sqrt(200)
    assert _uniform(p)


def _uniform(p: list[float]) -> bool:
    counts, _ = np.histogram(p, np.linspace(0.01, 1.01, 11))  # p is k/50: five values a class
    return chisquare(counts).pvalue > 1e-3


def test_p_is_uniform_for_kinds_of_equal_grains():
    """F1, with counts drawn in place of permutations."""
    rng, p = np.random.default_rng(12), []
    for _ in range(200):
        group = rng.permutation(np.arange(2000) % 4 > 0).astype(np.int64)
        p.append(permutation_p(np.where(group, 2.0, 3.0), group, rng.permutation(2000)[:1700], 2, rng, 49))
    assert _uniform(p)


def test_drawn_counts_have_the_distribution_of_permutations():
    """Three kinds in bins that hold part of the bed: mean and covariance of counts in closed form, each to five
    standard errors of 4000 draws; and every draw has as many grains as the bin."""
    counts, bins, draws = np.array([30, 20, 50]), np.array([40, 25]), 4000
    found = _shuffled_counts(counts, bins, np.random.default_rng(1), draws)
    assert (found.sum(axis=1) == bins).all()
    assert (found.sum(axis=2) <= counts).all()
    n, p = counts.sum(), counts / counts.sum()
    for k, size in enumerate(bins):
        variance = size * p * (1 - p) * (n - size) / (n - 1)
        assert found[:, :, k].mean(axis=0) == pytest.approx(size * p, abs=5 * np.sqrt(variance.max() / draws))
        assert found[:, :, k].var(axis=0) == pytest.approx(variance, rel=5 * math.sqrt(2 / draws))
    # between bins -n1 n2 p q/(n - 1)
    between = np.cov(found[:, 0, 0], found[:, 0, 1])[0, 1]
    assert between == pytest.approx(-bins[0] * bins[1] * p[0] * (1 - p[0]) / (n - 1), abs=0.4)


def test_slight_segregation_is_found():
    """The share of glass in the outflow rises from 0.15 to 0.35: SI^2 = (0.2^2/12)/0.25^2 of equal masses."""
    rng = np.random.default_rng(2)
    group = (rng.random(40_000) > 0.15 + 0.2 * np.arange(40_000) / 40_000).astype(np.int64)
    shares = outflow_shares(np.ones(40_000), group, np.arange(40_000), 2)
    # a bin has an error of sqrt(0.25*0.75/2000) = 0.0097 against a standard deviation of 0.058: 4 % of SI^2 a bin
    assert segregation(np.ones(40_000), group, shares, 2000)[0] == pytest.approx(0.04 / 12 / 0.25**2, rel=0.2)


def test_lacey_index_of_known_beds():
    rng, n = np.random.default_rng(4), 4000
    x = rng.uniform(0, 0.04, (n, 3))
    x[0] = 0.0
    mass = rng.choice([1.0, 3.0], n)
    apart, cells = lacey_index(mass, (x[:, 2] >= 0.02).astype(np.int64), x, 0.01)
    assert cells == 64
    assert apart == pytest.approx(0, abs=1e-12), "every cell has one class"
    mixed = [lacey_index(mass, rng.integers(0, 2, n), x, 0.01)[0] for _ in range(64)]
    assert abs(np.mean(mixed) - 1) < 3 * np.std(mixed) / 8
    # half of every cell above the middle is exchanged at random: composition 3/4 and 1/4, s^2 a quarter of s_0^2
    half = np.where(rng.random(n) < 0.5, x[:, 2] >= 0.02, rng.integers(0, 2, n)).astype(np.int64)
    assert lacey_index(np.ones(n), half, x, 0.01)[0] == pytest.approx(0.75, abs=0.04), "3 errors of s^2: 4000 grains"


def test_sizes_of_one_kind_are_fine_and_coarse():
    run = run_of(RANDOM, np.arange(N), sizes=Uniform(smallest=1e-3))
    found = numbers(run)
    assert {"flow_rate_of_fine", "flow_rate_of_coarse", "segregation_fine"} <= found.keys()
    assert run.rows("crossing").keys() == {"time", "id", "radius", "mass"}, "there are no kinds"


def test_too_few_grains_and_scenes_without_a_composition():
    few = numbers(run_of(RANDOM, np.arange(N), left=700))
    assert math.isnan(few["segregation_glass"].value)
    assert "fewer than two bins" in few["segregation_p"].note
    assert math.isfinite(few["lacey_index"].value)
    scene = run_of(RANDOM, np.arange(N)).scene
    with pytest.raises(MeasureError, match="all grains are equal"):
        MEASURE.check(scene.model_copy(update={"grains": Spheres(diameter=D, density=2500, count=N)}))
    small = scene.model_copy(update={"grains": scene.grains.model_copy(update={"count": 700})})
    assert MEASURE.foreseen_empty(scene) is None
    told = MEASURE.foreseen_empty(small)
    assert told is not None
    assert "two bins of 400 grains" in told[0]
    assert told[1] == "use 800 grains or more"


def test_p_is_the_same_at_every_evaluation():
    run = run_of(RANDOM, np.arange(N))
    assert numbers(run)["segregation_p"] == numbers(run)["segregation_p"]
    assert numbers(run)["segregation_p"].value != numbers(replace(run, seed=2))["segregation_p"].value
