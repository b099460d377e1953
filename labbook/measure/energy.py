"""Energy balance of a discharge: where the potential energy of the bed goes."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Dissipation, Ledger, Probe
from labbook.measure.data import RunData
from labbook.measure.flow import FlowRate
from labbook.measure.ledger import ledger_interval
from labbook.measure.measure import (
    Evaluation,
    Measure,
    MeasureError,
    Quantity,
    Window,
    flow_suffix,
    while_flowing,
    window_in_words,
)
from labbook.measure.steady import outflow
from labbook.scene import Bodies, Scene
from labbook.scene.orientation import axes, rotated
from labbook.stats import Measured
from labbook.stats.correlation import block_mean

_FEWEST = 16
"""Samples within the window below which there is no balance."""
_BLOCKS = 8
_TERMS = (
    Quantity("power_released", "P_g", "W", "potential energy that the bed gives up per time", "mW", 1e3),
    Quantity("power_carried", "P_out", "W", "kinetic energy of the grains that leave, per time", "mW", 1e3),
    Quantity("power_contacts", "P_c", "W", "power that contacts take from the grains, of all steps", "mW", 1e3),
    Quantity("power_rest", "P_rest", "W", "power released less the other terms", "mW", 1e3, about_zero=True),
)
_SAMPLED = (
    Quantity("power_normal", "P_n", "W", "power dissipated along the normals of contacts", "mW", 1e3),
    Quantity("power_friction", "P_t", "W", "power dissipated by tangential forces in contacts", "mW", 1e3),
    Quantity("power_rolling", "P_r", "W", "power dissipated by rolling friction", "mW", 1e3, about_zero=True),
    Quantity("elastic_energy", "E_el", "J", "half the sum of normal force times overlap", "mJ", 1e3),
)


@dataclass(frozen=True)
class InsideEnergies:
    """Energies of the grains that have not left, at one instant.

    Attributes:
        kinetic: Kinetic energy of translation and rotation [J].
        potential: Potential energy [J].
    """

    kinetic: float
    potential: float


class EnergyBalance(Measure):
    """Measure the energy balance of the grains that have not left, per time, within the window of the flow rate.

    P_g = P_out + P_c + dE_kin/dt + P_rest. Elastic energy that springs store and give back within the window cancels.
    The potential energy of grains that left, but are still followed, is that of free fall from the outlet. The parts of
    P_c are given for spheres only, since the contact points of rods and clumps are not known. Quantities of a run that
    clogged end in `_flowing`.

    Quantities:
        power_released: P_g [W], potential energy that the bed gives up per time.
        power_carried: P_out [W], kinetic energy of the grains that leave per time.
        power_contacts: P_c [W], power that contacts take from the grains by the `ledger`, net of the power of moving
            walls.
        power_rest: P_rest [W], error of the balance.
        power_normal: Power of normal forces on the relative motion in contacts [W], sampled
            (`labbook.backend.probes.Dissipation`).
        power_friction: Power of tangential forces [W], sampled in the same way.
        power_rolling: P_c less both, with the power of moving walls added [W]: torques of rolling friction, and the
            error of sampling.
        elastic_energy: Half the sum of normal force times overlap [J], the energy of linear springs; Hertzian springs
            hold four fifths of it.

    Arrays:
        time, normal_power, tangential_power, wall_power, elastic: Sampled times [s], powers [W] and energies [J] of
            spheres, shape [n].

    Raises:
        MeasureError: The silo is fed, goes on below the outlet, or has no outlet or no gravity.
    """

    name = "energy"
    version = 2
    needs_all = True
    declared = (*_TERMS, *_SAMPLED, *map(while_flowing, (*_TERMS, *_SAMPLED)))

    def check(self, scene: Scene) -> None:
        FlowRate().check(scene)
        if scene.feed is not None:
            reason = "energy is the balance of a discharge, and this silo is fed"
            raise MeasureError(reason, "take energy out of measure, or leave out feed")
        if scene.sink is not None:
            reason = "energy is the balance of what lies above the outlet, and this container goes on below it"
            raise MeasureError(reason, "take energy out of measure, or leave out container.sink and container.lip")
        if scene.gravity == 0:
            reason = "energy is sampled at a multiple of sqrt(d/g), and there is no gravity"
            raise MeasureError(reason, "take energy out of measure, or use a gravity above 0 m/s^2")

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        self.check(scene)
        plane, every = scene.container.outlet_plane, ledger_interval(scene, numerics)
        assert plane is not None
        sampled = (Dissipation(every=every),) if _splits(scene) else ()
        return (Crossing(plane), Ledger(every=every), *sampled)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        splits = _splits(run.scene)
        if not {"ledger", *(("dissipation",) if splits else ())} <= set(run.tables):
            raise MeasureError("energy: the run recorded no powers of contacts; run it again with this measure")
        table = run.tables["dissipation"] if splits else {}
        names = ("time", "normal_power", "tangential_power", "wall_power", "elastic")
        arrays = {name: np.asarray(table[name], float) for name in names} if splits else {}
        return Evaluation(tuple(_terms(run, window, arrays)), arrays)


def _splits(scene: Scene) -> bool:
    """True for spheres. Contact points of rods and clumps are not known, so that the power of contacts is not split."""
    return scene.grains.round


def _terms(run: RunData, window: Window, arrays: Mapping[str, np.ndarray]) -> Iterator[Measured]:
    flow, _ = outflow(run, window)
    ledger = np.asarray(run.tables["ledger"]["time"], float)
    time, terms = arrays.get("time", ledger), (*_TERMS, *(_SAMPLED if arrays else ()))
    inside = np.zeros(len(time), bool) if flow is None else (time >= flow.begin) & (time <= flow.end)
    ends = np.zeros(0, np.int64) if flow is None else np.flatnonzero((ledger >= flow.begin) & (ledger <= flow.end))
    if inside.sum() < _FEWEST or len(ends) < 2:
        fewer = f"only {int(inside.sum())} samples within the window, fewer than {_FEWEST}"
        note = "too few grains left for a window" if flow is None else f"{fewer}; lower numerics.steps_per_beat"
        for term in terms:
            none = (math.nan, math.nan, 0, window_in_words(window), "sampled steps", term.unit, note)
            yield Measured(term.name + flow_suffix(run), *none)
        return
    first, last = (_inside(run, int(row)) for row in ends[[0, -1]])
    begin, end = float(ledger[ends[0]]), float(ledger[ends[-1]])
    carried, fallen = _left(run, begin, end)
    span = end - begin
    released, kinetic = (first.potential - last.potential - fallen) / span, (last.kinetic - first.kinetic) / span
    work = np.asarray(run.tables["ledger"]["contact_work"], float)[ends]
    contacts = float(work[0] - work[-1]) / span
    mean = {name: float(arrays[name][inside].mean()) for name in arrays}
    error = {name: block_mean(arrays[name][inside], _BLOCKS).error for name in arrays}
    where = f"{begin:.4g} s to {end:.4g} s, grains that have not left"
    by_ends, sampled = "energies at both ends; error from seeds only", f"mean of {int(inside.sum())} sampled steps"
    blocks = f"{sampled}; error from {_BLOCKS} blocks"
    values = [
        (released, math.nan, by_ends),
        (carried / span, math.nan, "velocities at the outlet; error from seeds only"),
        (contacts, math.nan, "work of contacts at every step; error from seeds only"),
        (released - carried / span - contacts - kinetic, math.nan, "released less the others; error from seeds only"),
    ]
    if arrays:
        rolling = contacts + mean["wall_power"] - mean["normal_power"] - mean["tangential_power"]
        of_rolling = math.hypot(error["normal_power"], error["tangential_power"])
        values += [
            (mean["normal_power"], error["normal_power"], blocks),
            (mean["tangential_power"], error["tangential_power"], blocks),
            (rolling, of_rolling, "work of contacts less that of their forces; error of the sampled ones"),
            (mean["elastic"], error["elastic"], blocks),
        ]
    for term, (value, deviation, how) in zip(terms, values, strict=True):
        yield Measured(
            term.name + flow_suffix(run), float(value), float(deviation), int(inside.sum()), where, how, term.unit, ""
        )


def _inside(run: RunData, row: int) -> InsideEnergies:
    """Compute the energies at a row of the ledger without the grains that have left and are still followed.

    These fall freely from the outlet.
    """
    ledger, g = run.tables["ledger"], run.scene.gravity
    time = float(ledger["time"][row])
    left = _crossed(run)
    before = left["time"] <= time
    # The ledger counts the grains that the backend follows: of those that left, it has dropped the lowest ones.
    followed = int(before.sum()) - (len(run.start) - int(ledger["grains"][row]))
    fall = time - left["time"][before]
    z = left["z"][before] + left["vz"][before] * fall - g / 2 * fall**2
    highest = np.argsort(z)[::-1][: max(followed, 0)]
    mass = left["mass"][before][highest]
    potential = float(mass @ z[highest]) * g
    energy = float((left["kinetic"][before] + left["mass"][before] * g * left["z"][before])[highest].sum())
    return InsideEnergies(
        float(ledger["kinetic"][row]) - (energy - potential), float(ledger["potential"][row]) - potential
    )


def _left(run: RunData, begin: float, end: float) -> tuple[float, float]:
    """Kinetic and potential energy [J] with which grains left between two instants [s]."""
    left = _crossed(run)
    now = (left["time"] > begin) & (left["time"] <= end)
    return float(left["kinetic"][now].sum()), float(left["mass"][now] @ left["z"][now]) * run.scene.gravity


def _crossed(run: RunData) -> dict[str, np.ndarray]:
    """Time [s], height [m], vertical velocity [m/s], mass [kg] and kinetic energy [J] of each grain that left."""
    table, bodies = run.tables["crossing"], Bodies.of(run.scene.grains, run.start)
    grain = run.start.rows(np.asarray(table["id"]))
    speed2, spin2 = (sum(np.asarray(table[f"{name}{axis}"], float) ** 2 for axis in "xyz") for name in "vw")
    columns = {name: np.asarray(table[name], float) for name in ("time", "z", "vz")}
    kinetic = 0.5 * (bodies.mass[grain] * speed2 + bodies.inertia[grain] * spin2)
    if not _splits(run.scene):
        q, w = (np.column_stack([np.asarray(table[name], float) for name in names.split()])
                for names in ("qw qx qy qz", "wx wy wz"))  # fmt: skip
        # the inertia of `bodies` is that across a rod: that about its axis is smaller, and of clumps that about the
        # first axis is larger
        about_axis, grains = np.sum(axes(q) * w, axis=1) ** 2, run.scene.grains
        kinetic += 0.5 * (grains.inertia_axis - bodies.inertia[grain]) * about_axis
        about_first = np.sum(rotated(q, (1.0, 0.0, 0.0)) * w, axis=1) ** 2
        kinetic += 0.5 * (grains.largest_inertia - bodies.inertia[grain]) * about_first
    return {**columns, "mass": bodies.mass[grain], "kinetic": kinetic}
