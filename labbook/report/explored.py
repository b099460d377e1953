"""Tables of what matters and what to run next: the same for the page and for the terminal."""

import math

from labbook.report.tables import Table
from labbook.results import display
from labbook.results.explore import DesignSurface, Influence, NextRuns
from labbook.scene.quantities import duration, percent

SHARES = (
    "Share: part of the variance of {quantity} over the swept range, all values alike. Change: from the smallest to "
    "the largest value of the key, the others averaged. Intervals are 95 %."
)
GAINS = (
    "Interval: 95 %, of the surface at the design. Gain: part of the surface’s mean variance that the runs remove, "
    "with the designs above in place. Time: as that of stored runs on one lane, fillings included."
)


def influence_table(surface: DesignSurface) -> Table:
    """Share and change of each key, with intervals."""
    several = len(surface.factors) > 1
    rows = [
        (*((_share(influence),) if several else ()), _change(surface, influence)) for influence in surface.influences
    ]
    names = [display.spoken(influence.key) if influence.key else "only together" for influence in surface.influences]
    name = display.quantity(surface.quantity, surface.unit).name
    note = SHARES.format(quantity=f"ln {name}" if surface.logarithmic else name)
    headings = ("key", *(("share (95 %)",) if several else ()), f"change of {name} (95 %)")
    notes = (note, surface.verdict) if several else ()
    return Table(headings, tuple((first, *rest) for first, rest in zip(names, rows, strict=True)), notes=notes)


def next_table(surface: DesignSurface) -> Table:
    """Designs to run next, with what they cost and gain."""
    keys = tuple(display.key(key).heading for key in surface.keys)
    rows = tuple(
        (
            *(display.amount(key, runs.at[key]) for key in surface.keys),
            "new" if runs.point is None else f"{runs.point}",
            f"{runs.runs}",
            f"{_half(surface, runs.half_width)} → {_half(surface, runs.half_width_then)}",
            percent(runs.gain, ".0f"),
            "–" if math.isnan(runs.seconds) else duration(runs.seconds),
            "–" if math.isnan(runs.seconds) else percent(runs.per_second, ".2g"),
        )
        for runs in surface.next_runs
    )
    headings = (*keys, "point", "runs", "interval now → then", "gain", "time", "gain per second")
    notes = (GAINS, *((WITHOUT_LAW,) if surface.curve is not None else ())) if rows else (NOTHING,)
    return Table(headings, rows, text=frozenset(), notes=notes)


WITHOUT_LAW = "Interval and gain are of a smooth surface, which assumes less than a fitted law."
NOTHING = "No design would narrow the surface by 2 % with twice the beds of the study."


def runs_and_time(designs: tuple[NextRuns, ...]) -> str:
    """`18 runs, about 53 s`."""
    runs, seconds = sum(one.runs for one in designs), sum(one.seconds for one in designs)
    return f"{runs} runs" + ("" if math.isnan(seconds) else f", about {duration(seconds)}")


def _share(one: Influence) -> str:
    low, high = (f"{100 * end:.0f}" for end in (one.low, one.high))
    return f"{percent(one.share, '.0f')} ({low} to {high} %)"


def _change(surface: DesignSurface, influence: Influence) -> str:
    if math.isnan(influence.change):
        return "–"
    values = influence.change, influence.change_low, influence.change_high
    if surface.logarithmic:
        value, low, high = (f"{100 * x:+.0f}".replace("-", "−") for x in values)
        return f"{value} % ({low} to {high} %)"
    unit = display.quantity(surface.quantity, surface.unit)
    value, low, high = (display.number(x, (values[2] - values[1]) / 4, unit.scale) for x in values)
    return f"{value} {unit.unit}".rstrip() + f" ({low} to {high})"


def _half(surface: DesignSurface, half: float) -> str:
    if surface.logarithmic:
        return display.percentage(half)
    unit = display.quantity(surface.quantity, surface.unit)
    return f"±{half * unit.scale:.2g} {unit.unit}".rstrip()
