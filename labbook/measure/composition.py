"""Composition of the outflow of a mixture, and how well the bed is mixed before the opening."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.measure.data import RunData
from labbook.measure.flow import FlowRate
from labbook.measure.measure import (
    Evaluation,
    Measure,
    MeasureError,
    Quantity,
    Window,
    as_arrays,
    flow_suffix,
    from_arrays,
    while_flowing,
    window_in_words,
)
from labbook.measure.scales import gap
from labbook.measure.series import crossings, mean_mass
from labbook.measure.steady import BLOCKS, FEWEST, TimeWindow, outflow, steady_flow
from labbook.scene import Bodies, Grains, Scene
from labbook.stats import Measured

BIN = 400
"""Grains in a bin of the outflow, at least: the counting error of a share of one half is then 2.5 %."""
BINS = 20
"""Bins of the outflow, at most."""
SHUFFLES = 1000
"""Permutations of the labels in the permutation test."""
CELL = 4.0
"""Edge of the cells of the Lacey index, in diameters d of the largest grains."""
HALVES = ("fine", "coarse")
"""Names of the classes by size of grains without kinds."""


def class_names(grains: Grains) -> tuple[str, ...]:
    """Names of the classes of grains: their kinds; of one kind with several sizes `HALVES`; empty for equal grains."""
    if grains.kinds:
        return tuple(kind.name for kind in grains.kinds)
    return HALVES if grains.varied else ()


def classes_of(grains: Grains, bodies: Bodies) -> np.ndarray:
    """Class of each grain as its place in `class_names`, shape [n]. Sizes are divided in the middle of their range."""
    if grains.kinds:
        return bodies.kind
    return (bodies.radius > (grains.finest + grains.diameter) / 4).astype(np.int64)


@dataclass(frozen=True, eq=False)
class OutflowShares:
    """Mass fraction of each of s classes in b bins of the outflow with equally many grains.

    Only complete bins count. After a full discharge they hold all grains.
    """

    fraction: np.ndarray
    """Discharged fraction M of the initial mass at the edges of the bins, shape [b + 1]."""
    share: np.ndarray
    """Mass fraction x_i of a class in a bin, shape [s, b]."""
    error: np.ndarray
    """Counting error of x_i, shape [s, b]: for grains of equal mass that of the binomial law, sqrt(x (1 - x)/n)."""
    mass: np.ndarray
    """Mass of a class in a bin [kg], shape [s, b]."""
    initial: np.ndarray
    """Mass fraction x_i0 of a class in the bed before the opening, shape [s]."""

    @classmethod
    def of(cls, evaluation: Evaluation) -> "OutflowShares | None":
        """Read the composition from an evaluation; None if no bin is complete."""
        return from_arrays(cls, evaluation.arrays)


def bin_edges(total: int, left: int, least: int = BIN) -> np.ndarray:
    """Numbers of grains that have left at the edges of the complete bins, shape [b + 1].

    Args:
        total: grains in the bed, which are divided into at most `BINS` bins.
        left: grains that left; more than `total` from a fed bed.
        least: grains in a bin, at least.
    """
    bins = max(1, min(BINS, total // least))
    complete = left * bins // total
    return np.arange(complete + 1) * total // bins


def outflow_shares(
    mass: np.ndarray, group: np.ndarray, rows: np.ndarray, classes: int, least: int = BIN
) -> OutflowShares:
    """Compute the composition of an outflow.

    Args:
        mass: of each grain of the bed [kg], shape [n].
        group: class of each grain, from 0 to `classes` - 1, shape [n].
        rows: grains in the order in which they left, shape [left].
        classes: number of classes.
        least: grains in a bin, at least.
    """
    edges = bin_edges(len(mass), len(rows), least)
    rows = rows[: edges[-1]]
    label = np.arange(classes)[:, None]
    of_classes = _sums(np.where(group[rows] == label, mass[rows], 0.0), edges)
    total = _sums(mass[rows], edges)
    share, initial = of_classes / total, np.array([mass[group == k].sum() for k in range(classes)]) / mass.sum()
    count = np.diff(edges)
    own = np.repeat(np.arange(len(count)), count)
    residual = _residuals(mass[rows], group[rows] == label, share[:, own], (total / count)[own])
    error = np.sqrt(_sums(residual**2, edges)) / count
    discharged = np.concatenate([[0.0], np.cumsum(total)]) / mass.sum()
    return OutflowShares(discharged, share, error, of_classes, initial)


def segregation(mass: np.ndarray, group: np.ndarray, shares: OutflowShares, count: float) -> np.ndarray:
    """Square of the segregation index SI of each class, without counting noise, shape [s]: SI^2 = (s^2 - S^2/n)/x_i0^2.

    s^2 is the variance of x_i over the bins of n = `count` grains. S^2/n is its expectation in a bed whose labels are
    distributed at random, where S^2 is the variance over all grains of (m/<m>) (1_i - x_i0); for equal masses it is the
    binomial variance x (1 - x). So a random bed has SI^2 = 0 on average, and a value below 0 is chance.
    """
    mean = np.full(len(mass), mass.mean())
    labelled = group == np.arange(len(shares.initial))[:, None]
    noise = _residuals(mass, labelled, shares.initial[:, None], mean).var(axis=1, ddof=1) / count
    return (shares.share.var(axis=1, ddof=1) - noise) / shares.initial**2


def permutation_p(
    mass: np.ndarray, group: np.ndarray, rows: np.ndarray, classes: int, rng: np.random.Generator, shuffles: int
) -> float:
    """Probability that a random bed has an outflow as uneven as this one, by shuffling the labels of all grains.

    The statistic is the variance of x_i over the bins, summed over classes. Size and kind of a grain move together.

    Args:
        mass: of each grain of the bed [kg], shape [n].
        group: class of each grain, shape [n].
        rows: grains in the order in which they left, shape [left].
        classes: number of classes.
        rng: source of the permutations.
        shuffles: number of permutations.
    """
    edges = bin_edges(len(mass), len(rows))
    rows = rows[: edges[-1]]
    # 1e-12: orders that are as uneven count as such, whatever the round-off of their sums
    observed = _unevenness(_class_sums(mass[rows], group[rows], edges, classes)) * (1 - 1e-12)
    of_class = [mass[group == k] for k in range(classes)]
    once = len(np.unique(rows)) == len(rows)  # no grain has come back
    if once and all(len(masses) and np.ptp(masses) <= 1e-12 * masses[0] for masses in of_class):
        # with equal masses within a class only numbers of grains matter: a thousand permutations cost nothing
        counts = _shuffled_counts(np.array([len(masses) for masses in of_class]), np.diff(edges), rng, shuffles)
        null = _unevenness(counts * np.array([masses[0] for masses in of_class])[:, None])
    else:
        null = np.empty(shuffles)
        for k in range(shuffles):
            shuffled = rng.permutation(len(mass))[rows]
            null[k] = _unevenness(_class_sums(mass[shuffled], group[shuffled], edges, classes))
    # The observed order is one of the permutations: a p of 0 would claim more than they can show.
    return (1 + int((null >= observed).sum())) / (1 + shuffles)


def _class_sums(mass: np.ndarray, group: np.ndarray, edges: np.ndarray, classes: int) -> np.ndarray:
    """Mass of each class in each bin, shape [classes, bins]."""
    return np.array([_sums(np.where(group == k, mass, 0.0), edges) for k in range(classes)])


def _unevenness(sums: np.ndarray) -> np.ndarray:
    """Variance of the mass fractions over bins, summed over classes; sums of shape [..., classes, bins]."""
    return (sums / sums.sum(axis=-2, keepdims=True)).var(axis=-1, ddof=1).sum(axis=-1)


def _shuffled_counts(counts: np.ndarray, bins: np.ndarray, rng: np.random.Generator, shuffles: int) -> np.ndarray:
    """Grains of each class in each bin after random permutations, shape [shuffles, classes, bins].

    Drawn class by class from hypergeometric distributions: that of a permutation, without permuting every grain.
    """
    left = np.tile(counts, (shuffles, 1))
    table = np.zeros((shuffles, len(counts), len(bins)), np.int64)
    for index, size in enumerate(bins):
        wanting = np.full(shuffles, size)
        for k in range(len(counts)):
            table[:, k, index] = rng.hypergeometric(left[:, k], left[:, k + 1 :].sum(axis=1), wanting)
            wanting = wanting - table[:, k, index]
        left = left - table[:, :, index]
    return table


def lacey_index(mass: np.ndarray, group: np.ndarray, x: np.ndarray, edge: float) -> tuple[float, int]:
    """Lacey index of a bed and the number of its occupied cells: M = (s_0^2 - s^2)/(s_0^2 - s_r^2).

    s^2 is the variance over cells of the mass fractions, weighted by the mass of the cells and summed over classes;
    s_0^2 is that of a separated bed, and s_r^2 its expectation in a random bed of these cells. M is 1 on average in a
    random bed, 0 if every cell has a single class, and NaN if a single cell is occupied. After Lacey, J. Appl. Chem. 4
    (1954) 257.

    Args:
        mass: of each grain [kg], shape [n].
        group: class of each grain, shape [n].
        x: positions of the grains [m], shape [n, 3].
        edge: of the cubic cells [m], which begin at the lowest coordinates of the grains.
    """
    index = np.floor((x - x.min(axis=0)) / edge).astype(np.int64)
    _, cell = np.unique(np.ravel_multi_index(index.T, index.max(axis=0) + 1), return_inverse=True)
    total, cells = mass.sum(), int(cell.max()) + 1
    of_cell = np.bincount(cell, mass)
    separated, present, random = 0.0, 0.0, 0.0
    for k in range(int(group.max()) + 1):
        share = mass[group == k].sum() / total
        separated += share * (1 - share)
        present += float(of_cell @ (np.bincount(cell, np.where(group == k, mass, 0.0)) / of_cell - share) ** 2) / total
        residual = _residuals(mass, group == k, np.array(share), mass.mean())
        random += residual.var(ddof=1) * (cells - 1) / len(mass)
    return ((separated - present) / (separated - random) if cells > 1 else math.nan), cells


def _sums(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Sums of `values`, shape [..., edges[-1]], within bins with these `edges`, shape [..., b]."""
    return np.add.reduceat(values, edges[:-1], axis=-1) if len(edges) > 1 else values[..., :0]


def _residuals(mass: np.ndarray, labelled: np.ndarray, share: np.ndarray, mean: np.ndarray | float) -> np.ndarray:
    """Contribution of each grain to x_i - `share`: its mean over a bin is that deviation, to first order."""
    return mass / mean * (labelled - share)


class Composition(Measure):
    """Measure the flow rate of each kind of grains, and the composition of the outflow.

    Kinds are those of `grains.kinds`. Grains of one kind with several sizes have the classes `fine` and `coarse`, below
    and above the middle of the range of diameters. Fewer than two complete bins of 400 grains give NaN and a note.

    Quantities:
        flow_rate_of_KIND: Mass flow rate [kg/s] of a kind over the window of the flow rate, which is their sum; of a
            run that clogged it ends in `_flowing`.
        segregation_KIND: Square of the segregation index over the complete bins of the outflow (`segregation`).
        segregation_p: p value of the permutation test (`permutation_p`).
        lacey_index: Lacey index of the bed before the opening (Lacey, J. Appl. Chem. 4 (1954) 257).

    Arrays:
        fraction, share, error, mass, initial: Those of `OutflowShares`.

    Raises:
        MeasureError: All grains are equal, or a kind has the name of an outlet.
    """

    name = "composition"
    version = 1
    needs_all = True
    declared = (
        Quantity(
            "segregation_p", "p", "", "p value of the composition of the outflow in a random bed", pooled=False
        ),
        Quantity("lacey_index", "Lacey", "", "Lacey index of the bed before the opening, in cells of 4 d"),
    )  # fmt: skip
    seed: ClassVar[int] = 1954
    """Seed of the permutations, beside that of the run."""

    def check(self, scene: Scene) -> None:
        FlowRate().check(scene)
        names = class_names(scene.grains)
        if len(names) < 2:
            reason = "composition tells kinds or sizes of grains apart, and all grains are equal"
            raise MeasureError(reason, "take composition out of measure, or state grains.kinds or grains.sizes")
        if both := {*names} & {outlet.name for outlet in scene.container.outlets}:
            reason = f"{both.pop()} is a kind of grains and an outlet"
            raise MeasureError(reason, "give one of them another name")

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        rates = tuple(_rate(name) for name in class_names(scene.grains))
        indices = tuple(_index(name) for name in class_names(scene.grains))
        return (*rates, *map(while_flowing, rates), *indices, *self.declared)

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        self.check(scene)
        return FlowRate().probes(scene, numerics)

    def foreseen_empty(self, scene: Scene) -> tuple[str, str] | None:
        if scene.grains.count >= 2 * BIN:
            return None
        reason = f"a segregation index needs two bins of {BIN} grains; only W of each kind is measured"
        return reason, f"use {2 * BIN} grains or more"

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        grains = run.scene.grains
        bodies, names = Bodies.of(grains, run.start), class_names(grains)
        group, rows = classes_of(grains, bodies), leaving(run)
        shares = outflow_shares(bodies.mass, group, rows, len(names))
        numbers = (
            *self._rates(run, window, group[rows]),
            *self._segregation(run, bodies.mass, group, rows, shares),
            _lacey(run, bodies.mass, group),
        )
        return Evaluation(numbers, as_arrays(shares) if shares.share.size else {})

    def _rates(self, run: RunData, window: Window, group: np.ndarray) -> Iterator[Measured]:
        flow, _ = outflow(run, window)
        times, weights = crossings(run)
        within = None if flow is None else TimeWindow(flow.begin, flow.end)
        how = f"crossings; error from {BLOCKS} blocks of equally many grains of all kinds"
        for index, name in enumerate(class_names(run.scene.grains)):
            quantity, mask = _rate(name).name + flow_suffix(run), group == index
            class_flow = None
            if within is not None and (mask & (times > within.start) & (times <= within.end)).sum() >= FEWEST:
                class_flow = steady_flow(times, len(run.start), within, weights * mask, gap(run.scene, window))
            if within is None or class_flow is None:
                few = f"too few grains: fewer than {FEWEST} of {name} in the window"
                where = window_in_words(within or window)
                yield Measured(quantity, math.nan, math.nan, 0, where, "crossings", "kg/s", few)
                continue
            where = f"{within.start:.4g} s to {within.end:.4g} s, as of all grains"
            value, error = mean_mass(run) * class_flow.rate, mean_mass(run) * class_flow.error
            yield Measured(quantity, value, error, class_flow.n_effective, where, how, "kg/s", "")

    def _segregation(
        self, run: RunData, mass: np.ndarray, group: np.ndarray, rows: np.ndarray, shares: OutflowShares
    ) -> Iterator[Measured]:
        names, bins = class_names(run.scene.grains), shares.share.shape[1]
        count = len(mass) / max(1, min(BINS, len(mass) // BIN))
        where = f"0 to {shares.fraction[-1]:.3g} of the mass discharged, {bins} bins of {count:.0f} grains"
        if bins < 2:
            note = f"fewer than two bins of {BIN} grains or more left"
            none = (math.nan, math.nan, 0, where, "crossings", "", note)
            yield from (Measured(name, *none) for name in (*(_index(kind).name for kind in names), "segregation_p"))
            return
        by = "variance over bins less that of a random bed; error from seeds only"
        for name, value in zip(names, segregation(mass, group, shares, count), strict=True):
            yield Measured(_index(name).name, float(value), math.nan, bins, where, by, "")
        # seeded by the run: an evaluation that is made again gives the same p
        rng = np.random.default_rng([self.seed, run.seed])
        p = permutation_p(mass, group, rows, len(names), rng, SHUFFLES)
        yield Measured("segregation_p", p, math.nan, SHUFFLES, where, f"{SHUFFLES} permutations of the labels", "")


def leaving(run: RunData) -> np.ndarray:
    """List grains as rows of the start, in the order in which they left, shape [left].

    Raises:
        MeasureError: The run recorded no crossings.
    """
    times, _ = crossings(run)
    table = run.tables["crossing"]
    order = np.argsort(table["time"], kind="stable")
    return run.start.rows(np.asarray(table["id"])[order]) if len(times) else np.zeros(0, np.int64)


def _lacey(run: RunData, mass: np.ndarray, group: np.ndarray) -> Measured:
    edge = CELL * run.scene.grains.diameter
    value, cells = lacey_index(mass, group, run.start.x, edge)
    where = f"bed before the opening, {cells} cells of {edge * 1e3:.4g} mm ({CELL:g} d)"
    how = "mass fractions in cells; error from seeds only"
    note = "" if math.isfinite(value) else "the bed is too small for cells of this size"
    return Measured("lacey_index", value, math.nan, cells, where, how, "", note)


def _rate(name: str) -> Quantity:
    meaning = f"mass flow rate of {name} in the window"
    return Quantity(f"flow_rate_of_{name}", f"W of {name}", "kg/s", meaning, "g/s", 1e3)


def _index(name: str) -> Quantity:
    meaning = f"square of the segregation index of {name} over the outflow, without counting noise"
    return Quantity(f"segregation_{name}", f"SI^(2) of {name}", "", meaning, about_zero=True)
