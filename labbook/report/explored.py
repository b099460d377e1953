"""The map of two swept keys in a report, and tables of what matters and what to run next."""

import math
from pathlib import Path

from labbook.report import figures
from labbook.report.blocks import Block, Prose, Section, picture
from labbook.report.tables import Table
from labbook.results import display
from labbook.results.explore import DesignSurface, Influence, NextRuns, explore, swept_keys
from labbook.results.points import FLOW_RATE
from labbook.results.study import StudyResults
from labbook.results.surface import NoSurface
from labbook.scene.quantities import duration, percent

SHARES = (
    "Share: part of the variance of {quantity} over the swept range, all values with equal weight. "
    "Change: from the smallest to the largest value of the key, the others averaged. Intervals are 95 %."
)
GAINS = (
    "Interval: 95 %, of the surface at the design. Gain: part of the surface’s mean variance that the runs remove, "
    "with the designs above in place. Time: that of a device, as stored runs took it, fillings included."
)


def mapped(results: StudyResults) -> bool:
    """Decide if the flow rate of a study has a map: exactly two keys of numbers are swept, and no others."""
    keys, choices = swept_keys(results.points)
    several = any(len({result.at.get(name) for result in results.points}) > 1 for name in choices)
    return (
        len(keys) == 2 and not several and sum(FLOW_RATE in result.pooled for result in results.points) > len(keys) + 1
    )


def map_sections(results: StudyResults, folder: Path) -> list[Section]:
    """A section with the map of two swept keys, and what matters; none where the points do not determine a surface."""
    if not mapped(results):
        return []
    try:
        surface = explore(results)
    except NoSurface:
        return []
    names = " and ".join(display.spoken(key) for key in surface.keys)
    title = f"Flow rate over {names}"
    blocks: list[Block] = [
        picture(figures.design_map(surface), folder / "map", title.lower(), CAPTION),
        Prose(f"{surface.method[:1].upper()}{surface.method[1:]}.", note=True),
        influence_table(surface),
    ]
    return [Section(title, tuple(blocks))]


CAPTION = (
    "Circles: points, filled by their own mean; a ring marks a 95 % interval wider than ±15 %. Crosses: points that "
    "clogged or have no value. Colours and lines between the points: the surface, drawn only within their hull."
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
    runs, seconds = sum(design.runs for design in designs), sum(design.seconds for design in designs)
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
