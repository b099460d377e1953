"""Distributions of diameters: moments against integration, draws against the distribution, what is refused."""

import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import quad
from scipy.stats import kstest, lognorm, norm, truncnorm

from labbook.filling import place
from labbook.filling.placing import draw_sizes_and_kinds
from labbook.scene import (
    CylinderSilo,
    Kind,
    LinearSpringDashpot,
    LogNormal,
    Normal,
    Scene,
    SizeList,
    SizeTable,
    Spheres,
    Uniform,
)

D = 3e-3
DIAMETERS, MASS = (22.0, 20.0, 16.0, 12.5, 11.2, 10.0), (0.004, 0.096, 0.27, 0.17, 0.33, 0.13)
"""Six classes of a deck [mm], with mass fractions."""


def spheres(count=1000, **varied) -> Spheres:
    return Spheres(diameter=D, density=2500, count=count, **varied)


def _cut(median: float, spread: float, smallest: float, largest: float):
    """Density by number of a log-normal distribution within cuts, from SciPy's."""
    whole: Any = lognorm(spread, scale=median)
    within = whole.cdf(largest) - whole.cdf(smallest)
    return lambda d: whole.pdf(d) / within


@pytest.mark.parametrize(("median", "spread", "smallest"), [(0.5, 0.3, 0.2), (0.3, 1.0, 0.1), (0.9, 0.1, 0.8)])
@pytest.mark.parametrize("power", [1, 3, 4])
def test_moments_of_a_lognormal_are_those_of_its_cut_density(median, spread, smallest, power):
    sizes = LogNormal(median=median * D, spread=spread, smallest=smallest * D)
    density = _cut(median, spread, smallest, 1.0)
    integral = quad(lambda x: x**power * density(x), smallest, 1.0, epsabs=0, epsrel=1e-11)[0]
    assert sizes.moment(power, D) / D**power == pytest.approx(integral, rel=1e-9)


def test_without_cuts_moments_are_those_of_the_textbook():
    """A spread of 5 % has its cuts 14 deviations away: <D^n> = M^n exp(n^2 s^2/2)."""
    sizes = LogNormal(median=D / 2, spread=0.05, smallest=D / 8)
    for power in (1, 3, 4):
        expected = (D / 2) ** power * math.exp(power**2 * 0.05**2 / 2)
        assert sizes.moment(power, D) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("median", "spread", "smallest"), [(0.5, 0.3, 0.2), (0.6, 1.5, 0.1)])
def test_a_lognormal_by_mass_is_that_by_number_weighted_by_volume(median, spread, smallest):
    """Its density by mass, cut, integrates to the same moments: <D^n> = int f_m D^(n - 3)/int f_m D^-3. The second case
    has its cuts in the far upper tail by number."""
    sizes = LogNormal(median=median * D, spread=spread, smallest=smallest * D, by="mass")
    density = _cut(median, spread, smallest, 1.0)
    for power in (1, 3, 4):
        over, under = (
            quad(lambda x, k=k: density(x) * x ** (k - 3), smallest, 1.0, epsabs=0, epsrel=1e-11)[0] for k in (power, 0)
        )
        assert sizes.moment(power, D) / D**power == pytest.approx(over / under, rel=1e-8)


def test_moments_of_uniform_and_normal_sizes():
    uniform, normal = Uniform(smallest=0.4 * D), Normal(mean=0.8 * D, deviation=0.15 * D)
    cut = truncnorm(-0.2 / 0.15, 0.2 / 0.15, 0.8, 0.15)
    for power in (1, 2, 3, 4):
        flat = quad(lambda x, n=power: x**n / 0.6, 0.4, 1.0)[0]
        assert uniform.moment(power, D) / D**power == pytest.approx(flat, rel=1e-12)
        assert normal.moment(power, D) / D**power == pytest.approx(cut.moment(power), rel=1e-9)
    assert uniform.moment(3, D) == pytest.approx(uniform.mean_cube(D), rel=1e-14)
    assert normal.moment(3, D) == pytest.approx(normal.mean_cube(D), rel=1e-14)


@pytest.mark.parametrize("by", ["number", "mass"])
def test_drawn_diameters_follow_a_cut_lognormal(by):
    sizes = LogNormal(median=0.5 * D, spread=0.6, smallest=0.15 * D, by=by)
    diameter, _ = draw_sizes_and_kinds(spheres(100_000, sizes=sizes), 1, 1)
    assert diameter is not None
    middle = math.log(0.5) - (3 * 0.6**2 if by == "mass" else 0)
    low, high = (norm.cdf((math.log(cut) - middle) / 0.6) for cut in (0.15, 1.0))
    assert kstest(diameter / D, lambda x: (norm.cdf((np.log(x) - middle) / 0.6) - low) / (high - low)).pvalue > 1e-3
    assert diameter.min() >= 0.15 * D
    assert diameter.max() <= D


def test_mass_fractions_of_a_table_are_those_of_the_grains():
    grains = Spheres(
        diameter=22e-3,
        density=3200,
        count=20_000,
        sizes=SizeTable(diameters=tuple(1e-3 * d for d in DIAMETERS), mass_fractions=MASS),
    )
    diameter, _ = draw_sizes_and_kinds(grains, 1, 1)
    assert diameter is not None
    for size, fraction in zip(DIAMETERS, MASS, strict=True):
        mine = np.isclose(diameter, 1e-3 * size)
        one = (1e-3 * size) ** 3 / (20_000 * grains.mean_cube)  # of one grain: numbers are whole
        assert np.sum(diameter[mine] ** 3) / np.sum(diameter**3) == pytest.approx(fraction, abs=2 * one + 1e-4)
    assert np.mean(diameter**3) == pytest.approx(grains.mean_cube, rel=1e-3)


def test_number_fractions_of_a_table_are_exact_to_a_grain_whatever_the_seed():
    sizes = SizeTable(diameters=(D / 3, D / 2, D), number_fractions=(0.5, 0.3, 0.2))
    counts = []
    for seed in (1, 2):
        diameter, _ = draw_sizes_and_kinds(spheres(1001, sizes=sizes), 1, seed)
        assert diameter is not None
        counts.append([int(np.sum(diameter == size)) for size in sizes.diameters])
        assert np.abs(np.array(counts[-1]) - 1001 * np.array((0.5, 0.3, 0.2))).max() < 1
    assert spheres(sizes=sizes).mean_diameter == pytest.approx(D * (0.5 / 3 + 0.15 + 0.2))


def test_as_many_grains_as_a_list_has_diameters_are_the_list():
    diameters = tuple(np.linspace(0.5 * D, D, 97).tolist())
    diameter, _ = draw_sizes_and_kinds(spheres(97, sizes=SizeList(diameters=diameters)), 1, 3)
    assert diameter is not None
    assert sorted(diameter) == list(diameters)
    assert not np.array_equal(diameter, np.sort(diameter))
    several, _ = draw_sizes_and_kinds(spheres(970, sizes=SizeList(diameters=diameters)), 1, 3)
    assert several is not None
    assert np.array_equal(np.unique(several, return_counts=True)[1], np.full(97, 10))


def test_means_by_number_and_by_mass():
    """Two classes, 1 and 2 units, half of the mass each: eight small ones for each large one."""
    grains = spheres(sizes=SizeTable(diameters=(D / 2, D), mass_fractions=(0.5, 0.5)))
    assert grains.mean_diameter == pytest.approx((8 / 9 * 0.5 + 1 / 9) * D)
    assert grains.mean_diameter_by_mass == pytest.approx(0.75 * D)
    assert grains.equivalent_diameter == pytest.approx(D * (2 / 9) ** (1 / 3))
    assert grains.mass == pytest.approx(2500 * math.pi / 6 * D**3 * 2 / 9)


def test_kinds_by_mass_have_the_shares_of_their_grains():
    steel, glass = {"density": 7800, "diameter": D / 2}, {"density": 2500}
    kinds = (Kind(name="glass", mass_share=0.7, **glass), Kind(name="steel", mass_share=0.3, **steel))
    grains = spheres(10_000, kinds=kinds)
    numbers = np.array([0.7 / 2500, 0.3 / (7800 / 8)])
    assert [one.share for one in grains.species] == pytest.approx(numbers / numbers.sum())
    diameter, kind = draw_sizes_and_kinds(grains, 1, 1)
    assert diameter is not None
    mass = np.where(kind == 1, 7800, 2500) * diameter**3
    assert mass[kind == 1].sum() / mass.sum() == pytest.approx(0.3, abs=1e-3)
    with pytest.raises(ValidationError, match="same way"):
        spheres(kinds=(Kind(name="a", mass_share=0.5), Kind(name="b", share=0.5, density=1000)))
    with pytest.raises(ValidationError, match="same way"):
        spheres(kinds=(Kind(name="a", mass_share=0.5, share=0.5), Kind(name="b", mass_share=0.5)))


@pytest.mark.parametrize("start", ["rain", "dense"])
def test_every_start_places_the_same_classes(start):
    sizes = SizeTable(diameters=(0.6 * D, D), mass_fractions=(0.5, 0.5))
    silo = CylinderSilo(diameter=10 * D, height=100 * D, orifice=5 * D)
    law = LinearSpringDashpot(normal_stiffness=1e4)
    packing = place(Scene(grains=spheres(200, sizes=sizes), contact=law, container=silo).close(), start, 1)
    share = 1 / (1 + 0.6**3)  # of the small ones by number
    assert packing.diameter is not None
    assert np.sum(packing.diameter < D) == pytest.approx(200 * share, abs=1)
    assert {*packing.diameter.tolist()} == {0.6 * D, D}


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        (SizeTable(diameters=(0.5 * D, 0.9 * D), number_fractions=(0.5, 0.5)), "grains.diameter be the largest"),
        (SizeTable(diameters=(0.05 * D, D), number_fractions=(0.5, 0.5)), "less than d/10"),
        (SizeTable(diameters=(0.5 * D, D), number_fractions=(0.5, 0.4)), "add up to 90 %"),
        (SizeTable(diameters=(0.5 * D, D), number_fractions=(1.0,)), "one fraction for each diameter"),
        (SizeTable(diameters=(0.5 * D, D)), "no fractions"),
        (SizeTable(diameters=(D,), number_fractions=(1.0,), mass_fractions=(1.0,)), "stated twice"),
        (SizeList(diameters=(0.5 * D, 1.1 * D)), "grains.diameter be the largest"),
        (LogNormal(median=1.1 * D, spread=0.3, smallest=0.5 * D), "between the smallest diameter and d"),
        (LogNormal(median=0.9 * D, spread=0.3, smallest=0.05 * D), "from d/10 to below d"),
    ],
)
def test_what_does_not_fit_is_refused(sizes, message):
    with pytest.raises(ValidationError, match=message):
        spheres(sizes=sizes)
