"""Spheres of several sizes and kinds: who is what, where they start, and what is measured of them."""

# a packing need not have diameters and kinds; those of these tests do
# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportOptionalOperand=false
# pyright: reportArgumentType=false, reportCallIssue=false

import math

import numpy as np
import pytest
from scipy.stats import kstest, truncnorm

from labbook.backend.numerics import Numerics
from labbook.filling import place
from labbook.filling.placing import draw_sizes_and_kinds, whole_numbers
from labbook.lab.tables import read_table, write_table
from labbook.measure import RunData
from labbook.measure.flow import FlowRate
from labbook.measure.packing import packing_fraction
from labbook.measure.region import Region
from labbook.scene import Bodies, HertzMindlin, Kind, Normal, Packing, Scene, Spheres, Uniform, WedgeHopper
from labbook.scene.timescales import collision, rayleigh
from labbook.study import Window

D = 3e-3
LAW = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25)
KINDS = (Kind(name="glass", share=0.7), Kind(name="steel", share=0.3, density=7800, diameter=D / 2))


def spheres(count=3000, **varied) -> Spheres:
    return Spheres(diameter=D, density=2500, count=count, **varied)


def scene(grains: Spheres, thickness=1.01 * D) -> Scene:
    silo = WedgeHopper(width=0.1, height=0.9, thickness=thickness, orifice=0.03, angle=1.0)
    return Scene(grains=grains, contact=LAW, container=silo)


@pytest.mark.parametrize(
    ("sizes", "law"),
    [
        (Uniform(smallest=D / 2), ("uniform", (D / 2, D / 2))),
        (Normal(mean=0.8 * D, deviation=0.15 * D), truncnorm(-4 / 3, 4 / 3, 0.8 * D, 0.15 * D).cdf),
    ],
)
def test_diameters_follow_their_distribution(sizes, law):
    grains = spheres(100_000, sizes=sizes)
    diameter, kind = draw_sizes_and_kinds(grains, 1, 1)
    assert kind is None
    assert kstest(diameter, *law if isinstance(law, tuple) else (law,)).pvalue > 1e-3
    low, high = sizes.range(D)
    assert low <= diameter.min()
    assert diameter.max() <= high == D
    assert np.mean(diameter**3) == pytest.approx(grains.mean_cube, rel=5e-3)
    assert Bodies.of(grains, packing(diameter)).mass.mean() == pytest.approx(grains.mass, rel=5e-3)


def packing(diameter, kind=None) -> Packing:
    zero = np.zeros((len(diameter), 3))
    return Packing(x=zero, v=zero, omega=zero, diameter=diameter, kind=kind)


def test_the_seed_decides_who_is_what_and_shares_are_exact():
    grains = spheres(1001, kinds=KINDS)
    (d1, k1), (d2, k2), (_, other) = (draw_sizes_and_kinds(grains, 1, seed) for seed in (1, 1, 2))
    assert np.array_equal(d1, d2)
    assert np.array_equal(k1, k2)
    assert not np.array_equal(k1, other)
    assert np.bincount(k1).tolist() == np.bincount(other).tolist() == [701, 300]
    assert (d1 == np.where(k1 == 1, D / 2, D)).all()


def test_whole_numbers_add_up_and_lie_within_one_of_their_shares():
    shares = np.random.default_rng(1).dirichlet(np.ones(7))
    for total in (1, 10, 1003):
        numbers = whole_numbers(shares, total)
        assert numbers.sum() == total
        assert np.abs(numbers - shares * total).max() < 1


def test_mass_and_inertia_are_those_of_solid_spheres():
    grains = spheres(2, kinds=KINDS)
    own = Bodies.of(grains, packing(np.array([D, D / 2]), np.array([0, 1])))
    assert own.mass == pytest.approx([2500 * math.pi / 6 * D**3, 7800 * math.pi / 6 * D**3 / 8])
    assert own.inertia == pytest.approx(0.4 * own.mass * np.array([D / 2, D / 4]) ** 2)
    assert grains.mass == pytest.approx(0.7 * own.mass[0] + 0.3 * own.mass[1])


def test_a_packing_that_does_not_fit_the_scene_is_refused():
    grains = spheres(2, kinds=KINDS)
    with pytest.raises(ValueError, match="no kinds of grains"):
        Bodies.of(grains, packing(np.array([D, D])))
    with pytest.raises(ValueError, match="not from 0 to 1"):
        Bodies.of(grains, packing(np.array([D, D]), np.array([0, 2])))
    with pytest.raises(ValueError, match="up to d"):
        Bodies.of(grains, packing(np.array([D, 2 * D]), np.array([0, 1])))
    with pytest.raises(ValueError, match="diameter has shape"):
        packing(np.array([D, D]), np.array([0, 1])).__class__(
            x=np.zeros((2, 3)), v=np.zeros((2, 3)), omega=np.zeros((2, 3)), diameter=np.ones(3)
        )


def test_a_stored_packing_keeps_them(tmp_path):
    placed = place(scene(spheres(50, kinds=KINDS)).close(), "gas", 1)
    write_table(tmp_path / "a.npz", placed.arrays())
    again = Packing(**read_table(tmp_path / "a.npz"))
    assert np.array_equal(again.diameter, placed.diameter)
    assert np.array_equal(again.kind, placed.kind)
    order = np.random.default_rng(1).permutation(50)
    assert np.array_equal(placed.renumbered(order).diameter, placed.diameter[order])
    assert np.array_equal(placed.mirrored().kind, placed.kind)
    assert np.array_equal(placed.rows(placed.ids[order]), order)


@pytest.mark.parametrize("kind", ["gas", "rain"])
@pytest.mark.parametrize(
    "grains",
    [
        spheres(1000, sizes=Uniform(smallest=D / 3)),
        spheres(1000, kinds=(Kind(name="big", share=0.02), Kind(name="small", share=0.98, diameter=D / 6))),
    ],
    ids=["uniform", "two sizes"],
)
def test_graded_grains_start_inside_and_touch_nothing(grains, kind):
    closed = scene(grains).close()
    start = place(closed, kind, 1)
    radius = start.diameter / 2
    apart = np.linalg.norm(start.x[:, None] - start.x[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    assert (apart > radius[:, None] + radius[None]).all()
    assert (np.abs(start.x[:, 0]) < 0.05 - radius).all()
    assert (np.abs(start.x[:, 1]) < 0.505 * D - radius).all()
    # large grains do not start lower or higher than small ones: ranks are uncorrelated, to three standard errors
    rank = [np.argsort(np.argsort(a)) for a in (radius + 1e-12 * np.arange(1000), start.x[:, 2])]
    assert abs(np.corrcoef(*rank)[0, 1]) < 0.1


def test_the_lightest_grains_decide_the_time_step():
    fine = spheres(kinds=KINDS)
    alone = [Spheres(diameter=d, density=rho, count=1) for d, rho in ((D, 2500), (D / 2, 7800))]
    scenes = [scene(grains) for grains in alone]
    mixed = scene(fine)
    assert rayleigh(mixed) == min(map(rayleigh, scenes))
    slow = [collision(one.model_copy(update={"gravity": one.gravity * D / one.grains.diameter})) for one in scenes]
    assert collision(mixed) == pytest.approx(min(slow))  # all fall from half of the largest diameter


def outflow(mass, times) -> RunData:
    """A run in which grains of `mass` (of two kinds) leave at `times` in the order of their ids."""
    kind = (np.asarray(mass) > np.min(mass)).astype(int)
    grains = spheres(len(mass), kinds=(Kind(name="a", share=0.5), Kind(name="b", share=0.5, density=7500)))
    start = Packing(*np.zeros((3, len(mass), 3)), kind=kind)
    table = {"time": np.asarray(times, float), "id": np.arange(len(mass)), "step": np.arange(len(mass))}
    return RunData(scene(grains), Numerics(dt=1e-6), 1, start, "finished", float(times[-1]), {"crossing": table})


def test_flow_is_counted_by_the_mass_of_each_grain():
    """Every second grain is three times as heavy: W is twice the light mass times the rate, whatever leaves when."""
    mass = np.tile([1.0, 3.0], 500)
    run = outflow(mass, np.arange(1, 1001) / 100)
    numbers = {m.quantity: m for m in FlowRate().evaluate(run, Window(start=0.2, end=0.6)).numbers}
    light = 2500 * math.pi / 6 * D**3
    assert numbers["grain_rate"].value == pytest.approx(100, rel=1e-9)
    assert numbers["flow_rate"].value == pytest.approx(200 * light, rel=5e-3)


def test_the_window_is_one_of_mass_and_heavy_grains_first_flow_faster():
    """Heavy grains leave first: W falls to a third where light ones come.

    1000 grains, 500 of mass 3 and 500 of mass 1 (of 2000): the window from 0.1 to 0.6 holds only heavy ones.
    """
    mass = np.repeat([3.0, 1.0], 500)
    run = outflow(mass, np.arange(1, 1001) / 100)
    light = 2500 * math.pi / 6 * D**3
    numbers = {m.quantity: m for m in FlowRate().evaluate(run, Window(start=0.1, end=0.6)).numbers}
    assert numbers["flow_rate"].value == pytest.approx(300 * light, rel=1e-9)
    assert numbers["grain_rate"].value == pytest.approx(100, rel=1e-9)
    assert numbers["flow_rate"].error == pytest.approx(0, abs=1e-9 * 300 * light)
    late = {m.quantity: m for m in FlowRate().evaluate(run, Window(start=0.8, end=1.0)).numbers}
    assert late["flow_rate"].value == pytest.approx(100 * light, rel=1e-9)


def test_the_error_of_the_flow_is_that_of_repeated_outflows():
    """Random times and masses: the stated error is the scatter between seeds, to its own uncertainty."""
    found = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        mass = rng.permutation(np.repeat([1.0, 3.0], 500))
        run = outflow(mass, np.cumsum(rng.exponential(0.01, 1000)))
        found.append({m.quantity: m for m in FlowRate().evaluate(run, Window(start=0.1, end=0.9)).numbers}["flow_rate"])
    scatter = np.std([m.value for m in found], ddof=1)
    assert np.sqrt(np.mean([m.error**2 for m in found])) == pytest.approx(scatter, rel=0.3)


def test_the_packing_fraction_counts_true_volumes():
    x = np.array([[0.0, 0, 0], [0.02, 0, 0]])
    region = Region((-0.01, -0.01, -0.01), (0.03, 0.01, 0.01), False)
    two = Packing(x=x, v=0 * x, omega=0 * x, diameter=np.array([6e-3, 2e-3]))
    volume = math.pi / 6 * (6e-3**3 + 2e-3**3)
    assert packing_fraction(two, Spheres(diameter=6e-3, density=1000, count=2), region) == pytest.approx(
        volume / (0.04 * 0.02 * 0.02), rel=1e-6
    )
