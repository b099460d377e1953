"""What the page shows first of a sweep: the flow rate against each swept key."""

import math
from collections.abc import Sequence
from pathlib import Path

from labbook.report import figures
from labbook.report.blocks import Block, Prose, Section, picture, slug
from labbook.report.tables import Table
from labbook.results import display
from labbook.results.against import Against, Line, Place, against
from labbook.results.points import FLOW_RATE
from labbook.results.series import PACKING_FRACTION
from labbook.results.study import Results

_CALLED = {FLOW_RATE: "Flow rate", PACKING_FRACTION: "Packing fraction"}
_LISTED = 3
"""Lines that a sentence names one by one."""


def found_against(results: Results) -> tuple[Against, ...]:
    """The flow rate against every swept key but the orifice; the packing fraction where nothing flowed out."""
    for quantity in _CALLED:
        if any(quantity in result.pooled for result in results.points):
            return against(results.points, quantity)
    return ()


def against_sections(results: Results, folder: Path) -> list[Section]:
    """A section for each swept key but the orifice: figure, sentence and table."""
    return [_section(one, results, folder) for one in found_against(results)]


def _section(found: Against, results: Results, folder: Path) -> Section:
    name, called = display.spoken(found.key), _CALLED[found.quantity]
    title = f"{called} against {name}"
    figure = figures.against_key(found)
    cut = " Arrowheads: the interval goes on beyond the panel." if figures.has_cuts(figure) else ""
    drawn = picture(figure, folder / f"against-{slug(found.key)}", title.lower(), f"{_caption(found)}{cut}")
    blocks: list[Block] = [Prose(text) for text in changes(found)]
    blocks += [drawn, against_table(found)]
    if found.unset:
        places = "; ".join(result.label for result in found.unset[:5])
        more = f" and {len(found.unset) - 5} more" if len(found.unset) > 5 else ""
        blocks.append(Prose(f"Not shown, as {name} is not set: {places}{more}.", note=True))
    return Section(title, tuple(blocks))


def changes(found: Against) -> list[str]:
    """Sentences on where the quantity differs most from that at the first value: one a line, or one for many lines."""
    name = display.quantity(found.quantity).name
    largest = [(line, place) for line in found.lines if (place := line.largest) is not None]
    if len(largest) <= _LISTED:
        return [_told(found, line, place, name) for line, place in largest]
    sizes = [(place.ratio.value, line, place) for line, place in largest if place.ratio is not None]
    ends = [min(sizes, key=lambda one: one[0]), max(sizes, key=lambda one: one[0])]
    low, high = (f"{_percent(place)} ({_where(found, line, place)})" for _, line, place in ends)
    first = _first(found)
    return [f"Largest changes relative to {name} at {first}: {low} to {high}."]


def _told(found: Against, line: Line, place: Place, name: str) -> str:
    assert place.ratio is not None
    assert line.first is not None
    ends = [display.number(end, place.ratio.error, 100) for end in (place.ratio.low, place.ratio.high)]
    sure = math.isfinite(place.ratio.half_width)
    interval = f"95 %: {ends[0]} to {ends[1]} %, {_rests(place)}" if sure else _unsure(found, line, place)
    open_one = "; no change is shown" if sure and place.ratio.low <= 1 <= place.ratio.high else ""
    at = f"at {display.setting(found.key, place.value)}"
    over = f"that at {_value(found, line.first.value)} {display.key(found.key).unit}".rstrip()
    before = f"{line.label}: " if line.label else ""
    return f"{before}{name} {at} is {_percent(place)} of {over} ({interval}){open_one}."


def _unsure(found: Against, line: Line, place: Place) -> str:
    """Why a ratio has no interval: one pair of runs, or one run at either value; and what became of others."""
    assert line.first is not None
    why = f"{_rests(place)}: no interval" if place.pairs else "one run: no interval"
    ends = [(one.value, one.result.remark) for one in (line.first, place) if one.result.remark]
    return "; ".join((why, *(f"at {_value(found, value)}: {remark}" for value, remark in ends)))


def _where(found: Against, line: Line, place: Place) -> str:
    return ", ".join(filter(None, (line.label, display.setting(found.key, place.value))))


def _first(found: Against) -> str:
    firsts = {line.first.value for line in found.lines if line.first is not None}
    return display.setting(found.key, next(iter(firsts))) if len(firsts) == 1 else "the first value"


def _value(found: Against, value: float | str) -> str:
    return display.amount(found.key, value)


def _percent(place: Place) -> str:
    assert place.ratio is not None
    return f"{display.with_error(place.ratio.value, place.ratio.error, 100)} %"


def against_table(found: Against) -> Table:
    """Every point: the other keys, the key, the quantity, its ratio to that at the first value and on what it rests."""
    others = list(dict.fromkeys(name for line in found.lines for name in line.at))
    shown = display.quantity(found.quantity)
    rows = []
    for line in found.lines:
        for place in line.places:
            at = (display.amount(name, line.at[name]) if name in line.at else "–" for name in others)
            pooled = place.result.pooled.get(found.quantity)
            value = "–" if pooled is None else display.with_error(pooled.value, pooled.error, shown.scale)
            interval = "–" if pooled is None else display.percentage(pooled.relative)
            rows.append((*at, _value(found, place.value), value, interval, *_ratio(place, line), place.result.remark))
    keys = (*others, found.key)
    headings = (*(display.key(name).heading for name in keys), shown.heading, "95 % interval")
    last = len(headings) + 3
    ratio = figures.ratio_heading(found)
    notes = (
        "± is one standard error; intervals are 95 %, by Student’s t. Ratios are from pairs of runs that start from "
        "the same packing, so that its effect cancels, or from independent runs (Welch).",
    )
    text = frozenset({last} | {k for k, name in enumerate(keys) if _worded(found, name)})
    headings = (*headings, ratio, "95 % interval of the ratio", "rests on", "remarks")
    return Table(headings, tuple(rows), text, notes=notes)


def _worded(found: Against, name: str) -> bool:
    values = found.values if name == found.key else [line.at.get(name) for line in found.lines]
    return any(isinstance(value, str) for value in values)


def _ratio(place: Place, line: Line) -> tuple[str, str, str]:
    if place is line.first:
        return "1", "–", "–"
    if place.ratio is None:
        return "–", "–", "–"
    ratio = place.ratio
    ends = (display.number(end, ratio.error) for end in (ratio.low, ratio.high))
    interval = " to ".join(ends) if math.isfinite(ratio.half_width) else "unknown"
    return display.with_error(ratio.value, ratio.error), interval, _rests(place)


def _rests(place: Place) -> str:
    return f"{place.pairs} pair{'' if place.pairs == 1 else 's'}" if place.pairs else "independent runs"


def _caption(found: Against) -> str:
    name = display.quantity(found.quantity).name
    pairs = {place.pairs > 0 for line in found.lines for place in line.places if place.ratio is not None}
    how = {
        frozenset({True}): "from pairs of runs that start from the same packing",
        frozenset({False}): "of independent runs (Welch)",
    }.get(frozenset(pairs), "from pairs of runs that start from the same packing, or of independent runs (Welch)")
    ratios = [place.ratio for line in found.lines for place in line.places if place.ratio is not None]
    with_intervals = "with 95 % intervals " if any(math.isfinite(one.half_width) for one in ratios) else ""
    below = f" Below: over {name} at {_first(found)}, {with_intervals}{how}." if ratios else ""
    text = f"Above: {name} with 95 % intervals.{below}"
    hollow = any(place.result.remark for line in found.lines for place in line.places)
    crossed = any(found.quantity not in place.result.pooled for line in found.lines for place in line.places)
    text += " Hollow: see the remarks in the table." if hollow else ""
    text += f" Cross: no {name}." if crossed else ""
    if found.along:
        with_it = _listed([display.spoken(other) for other in found.along])
        text += f" {with_it} {'change' if len(found.along) > 1 else 'changes'} along."
    return text


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
