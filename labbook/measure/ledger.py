"""Overlaps of grains, and the work of contacts, from the ledger of a run."""

import math

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Ledger, Probe
from labbook.measure.data import RunData
from labbook.measure.expected import window_time
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
from labbook.scene import Scene
from labbook.scene.timescales import gravity_time
from labbook.stats import Measured

NAME = "ledger"
_ROWS = 80
"""Rows within the window, if the outflow is as expected; slower flows have more. A discharge has twice as many."""
_LONGEST, _CLOSED = 6.0, 0.6  # sqrt(d*/g) between two rows: at most, and where no outflow can be foreseen
_FEWEST = 8
"""Rows below which there are no means."""
_OF_WINDOW = (
    Quantity(
        "mean_max_overlap", "⟨δ_max⟩/d", "", "mean over the window of the largest overlap of a sampled step", "%", 100
    ),
    Quantity("contact_loss", "P_c", "W", "energy that contacts take from the grains per unit time", "mW", 1e3),
)


class EnergyLedger(Measure):
    """Measure the largest overlap and the energies of a run, sampled at 100 to 200 steps of a discharge.

    Between two samples a contact may overlap more: `max_overlap` is a lower bound of the maximum over all steps, and
    grows with the number of samples. `mean_max_overlap` does not.

    kinetic + potential - contact_work is constant until the backend drops the first grain, and no balance is given
    after it. Before, it is constant by the definition of `contact_work`, at any time step: it is no test of the time
    step.

    Quantities:
        max_overlap: Largest overlap of any contact over the diameter d of the smallest grains, as the guard
            `numerics.overlap_limit` counts it.
        mean_max_overlap: Mean, over the window of the flow rate, of the largest overlap of each sampled step.
        contact_loss: Work that contacts took from the grains within the window, over its duration [W]: friction and
            damping, less the work of moving walls. Elastic energy counts as taken until it is given back.

    The latter two need an outlet; those of a run that clogged end in `_flowing`.

    Arrays:
        time: Sampled times [s], shape [n].
        kinetic, potential: Energies [J] of the grains that the backend follows, shape [n]: all in the container, and
            those that left until they are some lengths below the outlet.
        contact_work: Work of contacts on all grains [J], also on those that are no longer followed, shape [n].
        max_overlap: Largest overlap over d, shape [n]; the table of the probe has metres.
        grains: Number of grains that the backend follows, shape [n].

    Raises:
        MeasureError: There is no gravity.
    """

    name = NAME
    version = 2
    declared = (
        Quantity("max_overlap", "δ_max/d", "", "largest overlap of any contact in the sampled steps", "%", 100),
        *_OF_WINDOW,
        *map(while_flowing, _OF_WINDOW),
    )

    def check(self, scene: Scene) -> None:
        if scene.gravity == 0:
            reason = "ledger is sampled at a multiple of sqrt(d/g), and there is no gravity"
            raise MeasureError(reason, "take ledger out of measure, or use a gravity above 0 m/s^2")

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        return self.declared[:1] if scene.container.outlet_plane is None else self.declared

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        plane, ledger = scene.container.outlet_plane, Ledger(every=ledger_interval(scene, numerics))
        return (ledger,) if plane is None else (Crossing(plane), ledger)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        if "ledger" not in run.tables:
            raise MeasureError("ledger: the run recorded no energies and overlaps; run it again with this measure")
        rows = run.tables["ledger"]
        names = ("time", "kinetic", "potential", "contact_work", "max_overlap", "grains")
        arrays = {name: np.asarray(rows[name]) for name in names}
        arrays["max_overlap"] = arrays["max_overlap"] / run.scene.grains.finest
        numbers = (_largest(run, arrays["time"], arrays["max_overlap"]),)
        if run.scene.container.outlet_plane is not None:
            numbers += _of_window(run, window, arrays)
        return Evaluation(numbers, arrays)


def ledger_interval(scene: Scene, numerics: Numerics) -> int:
    """Number of beats between two rows of the ledger.

    It is a power of two, so that points of a sweep have few different intervals and share ensembles.
    """
    expected, scale = window_time(scene), gravity_time(scene)
    interval = min(expected / _ROWS, _LONGEST * scale) if math.isfinite(expected) else _CLOSED * scale
    return 2 ** max(0, round(math.log2(interval / numerics.beat)))


def _largest(run: RunData, time: np.ndarray, overlap: np.ndarray) -> Measured:
    where = f"whole run (to {run.duration:.4g} s)"
    if not len(time):
        note = "the run ended before the first sample"
        return Measured("max_overlap", math.nan, math.nan, 0, where, "sampled steps", "", note)
    how = f"largest of {len(time)} sampled steps; the maximum over all steps may be larger"
    return Measured("max_overlap", float(overlap.max()), math.nan, len(time), where, how, "")


def _of_window(run: RunData, window: Window, arrays: dict[str, np.ndarray]) -> tuple[Measured, ...]:
    suffix = flow_suffix(run)
    flow, _ = outflow(run, window)
    time = arrays["time"]
    inside = np.zeros(len(time), bool) if flow is None else (time >= flow.begin) & (time <= flow.end)
    rows = int(inside.sum())
    if flow is None or rows < _FEWEST:
        where = window_in_words(window)
        fewer = f"only {rows} sampled steps within the window, fewer than {_FEWEST}"
        note = "too few grains left for a window" if flow is None else f"{fewer}; lower numerics.steps_per_beat"
        none = (math.nan, math.nan, 0, where, "sampled steps")
        return tuple(Measured(quantity.name + suffix, *none, quantity.unit, note) for quantity in _OF_WINDOW)
    within, work = time[inside], arrays["contact_work"][inside]
    where = (
        f"{flow.fraction[0]:.3g} to {flow.fraction[1]:.3g} of the mass discharged "
        f"({within[0]:.4g} s to {within[-1]:.4g} s)"
    )
    how = f"mean of {rows} sampled steps; error from seeds only"
    mean, loss = float(arrays["max_overlap"][inside].mean()), float((work[0] - work[-1]) / (within[-1] - within[0]))
    by = "work of contacts between the first and the last sample in the window; error from seeds only"
    return (
        Measured(f"mean_max_overlap{suffix}", mean, math.nan, rows, where, how, ""),
        Measured(f"contact_loss{suffix}", loss, math.nan, rows, where, by, "W"),
    )
