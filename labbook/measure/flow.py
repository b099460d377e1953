"""Flow rate from crossing events."""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from labbook import html
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe
from labbook.chart import Chart
from labbook.measure.data import RunData
from labbook.measure.measure import (
    Evaluation,
    Measure,
    MeasureError,
    Quantity,
    Window,
    after_start_up,
    flow_suffix,
    while_flowing,
    window_in_words,
)
from labbook.measure.series import flow_series, mean_mass
from labbook.measure.steady import BLOCKS, TOO_FEW, SteadyFlow, outflow, too_few
from labbook.scene import Scene
from labbook.stats import Measured

if TYPE_CHECKING:
    import pandas as pd

ENDED = "the run ended within the window ({})"
CUT_SHORT = ENDED.format("finished")
"""Note on a run that met its stop rule before the window ended."""
WIDER = "use more grains or a wider window"
"""Remedy for too few grains in the window."""
GAPS = re.compile(r"(\d+) gaps? without flow left out, (\S+) s together")
"""Note of a run whose outflow stopped within the window: number and total time [s] of the gaps."""
_GRAINS_PER_BIN, _BINS = 25, 80  # of W(t): as fine as counting allows, and no finer than a figure shows
NO_PLATEAU = "no steady part: the start-up takes more than half of the outflow up to the end of the window"
"""Note on a run whose window was to open at the end of its start-up."""
WINDOW_START = "window_start"
"""Quantity: discharged fraction at which the window of a run opens."""
_RATES = (
    Quantity("flow_rate", "W", "kg/s", "mass flow rate in the window", "g/s", 1e3),
    Quantity("grain_rate", "Q", "1/s", "grains per second in the window"),
    Quantity("flow_rate_drift", "drift of W", "", "relative change of W across the window", "%", 100),
    Quantity(WINDOW_START, "end of the start-up", "", "mass discharged as the window opens (`auto`)", "%", 100),
)


class FlowRate(Measure):
    """Measure the mass flow rate W and the grain flow rate Q over the steady part of a discharge.

    W counts each grain's own mass. Rates of a run that clogged are those while it flowed, and end in `_flowing`. A
    window with too few grains gives a rate of NaN with a note. The note `trending` states that there is no plateau.

    Quantities:
        flow_rate: Mass flow rate W [kg/s].
        grain_rate: Grain flow rate Q [1/s].
        flow_rate_drift: Relative change of W across the window, from a straight line through 12 blocks.
        window_start: Discharged fraction at which the window opens; with `window.start: auto` only.
        gap_time: Sum of the gaps without flow [s], if there are any (Pongo et al. 2022).
        waiting_time: Time since the last grain of a run that clogged [s]; censored by the end of the run.

    Arrays:
        time, rate, window: Those of `Trace`: W(t) in at most 80 bins of at least 25 grains.

    Raises:
        MeasureError: The container has no outlet.
    """

    name = "flow_rate"
    version = 3
    declared = (
        *_RATES,
        *map(while_flowing, _RATES),
        Quantity("gap_time", "time without flow", "s", "sum of the gaps without a grain (window.gap)", pooled=False),
        Quantity(
            "waiting_time", "waiting time", "s", "time since the last grain of a clogged run (censored)", pooled=False
        ),
    )

    def check(self, scene: Scene) -> None:
        if scene.container.outlet_plane is None:
            reason = f"flow_rate needs an outlet, and the container ({scene.container.kind}) has none"
            raise MeasureError(reason, "take flow_rate out of measure, or give the container an outlet")

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        self.check(scene)
        plane = scene.container.outlet_plane
        assert plane is not None
        return (Crossing(plane),)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        flow, times = outflow(run, window)
        clogged = run.outcome == "clogged"
        suffix = flow_suffix(run)
        numbers = _rates(flow, suffix, run, times, window)
        if clogged:
            since = float(times[-1]) if len(times) else 0.0
            numbers += (_waiting(run.duration - since),)
        return Evaluation(numbers, _trace(run, times, flow))


@dataclass(frozen=True, eq=False)
class Trace:
    """Mass flow rate against time of one run.

    Attributes:
        time: Middles of the bins of time [s], shape [n].
        rate: W in each bin [kg/s], shape [n].
        window: Start and end [s] of the window of the mean; None without one.
    """

    time: np.ndarray
    rate: np.ndarray
    window: tuple[float, float] | None

    @classmethod
    def of(cls, evaluation: Evaluation) -> "Trace | None":
        """Read W(t) from an evaluation of `FlowRate`; None if no grain left."""
        if "time" not in evaluation.arrays:
            return None
        time, rate, window = (evaluation.arrays[name] for name in ("time", "rate", "window"))
        return cls(time, rate, (float(window[0]), float(window[1])) if len(window) else None)

    def frame(self) -> "pd.DataFrame":
        """Tabulate W(t).

        Returns:
            Columns `time` [s], `flow_rate` [kg/s] and `in_window`, true for times in the window of the mean; units are
            in `attrs`.
        """
        import pandas as pd

        start, end = self.window or (math.inf, -math.inf)
        inside = (self.time >= start) & (self.time <= end)
        table = pd.DataFrame({"time": self.time, "flow_rate": self.rate, "in_window": inside})
        table.attrs = {"units": {"time": "s", "flow_rate": "kg/s"}}
        return table

    def __repr__(self) -> str:
        window = "none" if self.window is None else f"{self.window[0]:.3g} to {self.window[1]:.3g} s"
        return (
            f"<W(t) at {len(self.time)} times from {self.time[0]:.3g} to {self.time[-1]:.3g} s, up to "
            f"{self.rate.max() * 1e3:.4g} g/s; window: {window}>"
        )

    def _repr_html_(self) -> str:
        """Draw the curve from 0 on both axes, with the window shaded."""
        chart = Chart("t [s]", "W [g/s]", (0.0, float(self.time[-1])), 1e3 * float(self.rate.max()))
        if self.window is not None:
            chart.shade(*self.window)
        chart.curve(self.time.tolist(), (1e3 * self.rate).tolist())
        notes = ["shaded: the window of the mean"] if self.window is not None else ["no window, so no mean"]
        return html.titled("Flow rate W(t)", chart.svg(), html.lines(notes))


def merge_notes(notes: Mapping[str, int]) -> dict[str, int]:
    """Merge notes that differ in their numbers only into one with a range.

    Args:
        notes: Number of runs by note.

    Returns:
        Number of runs by merged note.
    """
    few = {note: match for note in notes if (match := TOO_FEW.fullmatch(note))}
    gaps = {note: match for note in notes if (match := GAPS.fullmatch(note))}
    merged = {}
    if few:
        _, total, fewest = next(iter(few.values())).groups()
        left = _spread(int(match[1]) for match in few.values())
        merged[f"too few grains: {left} of {total} left, fewer than {fewest} in the window: {WIDER}"] = few
    if gaps:
        number = _spread(int(match[1]) for match in gaps.values())
        time = _spread(float(match[2]) for match in gaps.values())
        merged[f"{number} {'gap' if number == '1' else 'gaps'} without flow left out, {time} s together"] = gaps
    rest = {note: n for note, n in notes.items() if note not in few and note not in gaps}
    return {note: sum(notes[text] for text in group) for note, group in merged.items()} | rest


def _spread(numbers: Iterable[float]) -> str:
    """Write the smallest and the largest number as `1 to 10`; one number if they are equal."""
    ordered = sorted(numbers)
    return " to ".join(dict.fromkeys((f"{ordered[0]:.6g}", f"{ordered[-1]:.6g}")))


def _trace(run: RunData, times: np.ndarray, flow: SteadyFlow | None) -> dict[str, np.ndarray]:
    if not len(times):
        return {}
    # at most the whole run: `flow_series` refuses a bin that does not fit into it
    width = min(max(times[-1] / _BINS, _GRAINS_PER_BIN * times[-1] / len(times)), run.duration)
    time, rate = flow_series(run, float(width))
    return {"time": time, "rate": rate, "window": np.array([flow.begin, flow.end] if flow else [])}


def _rates(
    flow: SteadyFlow | None, suffix: str, run: RunData, times: np.ndarray, window: Window
) -> tuple[Measured, ...]:
    mass, basis = mean_mass(run), "mass" if run.scene.grains.varied else "grains"
    requested = window_in_words(window, basis)
    if flow is None:
        note = too_few(len(times), len(run.start))
        return tuple(
            Measured(quantity + suffix, math.nan, math.nan, 0, requested, "crossings", unit, note)
            for quantity, unit in (("flow_rate", "kg/s"), ("grain_rate", "1/s"))
        )
    covered = f"{flow.fraction[0]:.3g} to {flow.fraction[1]:.3g} of the {basis} discharged"
    where = f"{covered} ({flow.begin:.4g} s to {flow.end:.4g} s)"
    how, wider = f"crossings; error from {BLOCKS} blocks of equally many grains", 1.0
    if run.scene.feed is not None and flow.error > 0:
        # a fed bed may be the only run of its point: no scatter between seeds corrects an error that is too small
        how, wider = f"{how}, or from the autocorrelation if that is larger", flow.larger_error / flow.error
    note = "; ".join(_notes(flow, run, window))
    n, of_grains = flow.n_effective / wider**2, flow.grain_n_effective / wider**2
    numbers = [
        Measured("flow_rate" + suffix, mass * flow.rate, mass * flow.error * wider, n, where, how, "kg/s", note),
        Measured("grain_rate" + suffix, flow.grain_rate, flow.grain_error * wider, of_grains, where, how, "1/s", note),
        Measured(
            "flow_rate_drift" + suffix,
            flow.trend.drift,
            flow.trend.drift_error,
            BLOCKS,
            where,
            f"straight line through {BLOCKS} blocks of equally many grains",
            "",
            note,
        ),
    ]
    if after_start_up(window):
        how = "exponential start-up fitted to the crossings"
        numbers.append(Measured(WINDOW_START + suffix, flow.fraction[0], math.nan, 1, where, how, "", note))
    if flow.gaps:
        how = f"times between grains longer than {flow.longest:.4g} s"
        numbers.append(Measured("gap_time", flow.gap_time, math.nan, flow.gaps, where, how, "s", note))
    return tuple(numbers)


def _notes(flow: SteadyFlow, run: RunData, window: Window) -> list[str]:
    notes = []
    if flow.trend.trending or not flow.plateau:
        notes.append("trending")
    if not flow.plateau:
        notes.append(NO_PLATEAU)
    if flow.gaps:
        plural = "gap" if flow.gaps == 1 else "gaps"  # GAPS reads this note again
        notes.append(f"{flow.gaps} {plural} without flow left out, {flow.gap_time:.3g} s together")
    if math.isinf(window.end):
        short = False
    elif window.timed:
        short = run.duration < window.end * (1 - 1e-12)
    else:
        # masses are discrete: the next grain would have passed the end; half a grain more for unequal ones
        short = flow.fraction[1] < window.end - 1.5 * flow.heaviest
    if short:
        notes.append(ENDED.format(run.outcome))
    return notes


def _waiting(time: float) -> Measured:
    where, how = "after the last grain", "time without a grain until the run was stopped"
    return Measured("waiting_time", time, math.nan, 1, where, how, "s", "censored; clogged")
