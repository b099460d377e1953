"""First section of a sweep: the flow rate against each swept key."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from labbook.report import figures
from labbook.report.blocks import Block, Prose, Section, picture, slug
from labbook.report.tables import Table
from labbook.results import display
from labbook.results.against import Against, Line, RatioPoint, against
from labbook.results.points import FLOW_RATE, names_scene
from labbook.results.series import PACKING_FRACTION
from labbook.results.study import StudyResults
from labbook.stats import Pooled

_CALLED = {FLOW_RATE: "Flow rate", PACKING_FRACTION: "Packing fraction"}
_LISTED = 3
"""Lines that a sentence names one by one."""


def found_against(results: StudyResults) -> tuple[Against, ...]:
    """The flow rate against every swept key but the orifice; the packing fraction where nothing flowed out."""
    for quantity in _CALLED:
        if any(quantity in result.pooled for result in results.points):
            return against(results.points, quantity)
    return ()


def against_sections(results: StudyResults, folder: Path) -> list[Section]:
    """A section for each swept key but the orifice: figure, sentence and table."""
    return [_section(one, results, folder) for one in found_against(results)]


def _section(comparison: Against, results: StudyResults, folder: Path) -> Section:
    name, called = display.spoken(comparison.key), _CALLED[comparison.quantity]
    title = f"{called} against {name}"
    figure = figures.against_key(comparison)
    cut = " Arrowheads: the interval goes on beyond the panel." if figures.has_cuts(figure) else ""
    block = picture(
        figure, folder / f"against-{slug(comparison.key)}", title.lower(), f"{against_caption(comparison)}{cut}"
    )
    blocks: list[Block] = [Prose(text) for text in changes(comparison)]
    blocks += [block, against_table(comparison)]
    if comparison.unset:
        places = "; ".join(result.label for result in comparison.unset[:5])
        rest = f" and {len(comparison.unset) - 5} more" if len(comparison.unset) > 5 else ""
        blocks.append(Prose(f"Not shown, as {name} is not set: {places}{rest}.", note=True))
    return Section(title, tuple(blocks))


def changes(comparison: Against) -> list[str]:
    """Sentences on where the quantity differs most from that at the first value: one a line; for many lines one, on the
    line that changes most and the one that changes least, or on those that rise and fall most."""
    name = display.quantity(comparison.quantity).name
    largest = [(line, place) for line in comparison.lines if (place := line.largest) is not None]
    if len(largest) <= _LISTED:
        return [_ratio_sentence(comparison, line, place, name) for line, place in largest]
    bounded = [(line, place) for line, place in largest if math.isfinite(_change(place).error)]
    unbounded = len(largest) - len(bounded)
    ranked = sorted(bounded or largest, key=lambda one: _change(one[1]).value)
    if _change(ranked[0][1]).value < 0:
        ends = [ranked[0], ranked[-1]]
    else:  # all rise: the largest change first
        ends = [ranked[-1], ranked[0]]
    phrases: list[str] = []
    for line, place in ends if len(ranked) > 1 else ends[:1]:
        phrase, span = _change_phrase(place), _span(comparison, line, place)
        if phrases and phrase.partition(" ")[0] == phrases[0].partition(" ")[0]:
            phrase = phrase.partition(" ")[2]
        span = "" if phrases and f" {span}" in phrases[0] else f" {span}"
        phrases.append(f"{phrase}{span}{f' at {line.label}' if line.label else ''}")
    without = (
        f" {unbounded} of {len(largest)} lines rest on one run and have no interval." if unbounded and bounded else ""
    )
    return [f"{name} {', '.join(phrases)}.{without}"]


def _change(place: RatioPoint) -> Pooled:
    """The change relative to the value at the first place of the line."""
    assert place.ratio is not None
    return replace(place.ratio, value=place.ratio.value - 1)


def _change_phrase(place: RatioPoint) -> str:
    """`falls by 41 ± 4 %`, or `does not change` where the interval holds zero."""
    change = _change(place)
    size = f"{display.with_error(abs(change.value), change.error, 100)} %"
    unsure = " (no change is shown)" if change.low <= 0 <= change.high else ""
    return f"{'falls' if change.value < 0 else 'rises'} by {size}{unsure if math.isfinite(change.error) else ''}"


def _span(comparison: Against, line: Line, place: RatioPoint) -> str:
    """`from 20 to 90 deg`: the two values that a change lies between; words with their key."""
    assert line.first is not None
    if comparison.words or any(map(names_scene, comparison.along)):
        return f"from {comparison.setting(line.first)} to {comparison.setting(place)}"
    ends = f"from {_value(comparison, line.first.value)} to {_value(comparison, place.value)}"
    unit = display.key(comparison.key).unit
    return f"{ends} {unit}" if unit else f"from {display.spoken(comparison.key)} {ends.removeprefix('from ')}"


def _ratio_sentence(comparison: Against, line: Line, place: RatioPoint, name: str) -> str:
    assert place.ratio is not None
    assert line.first is not None
    ends = [display.number(end, place.ratio.error, 100) for end in (place.ratio.low, place.ratio.high)]
    sure = math.isfinite(place.ratio.half_width)
    interval = f"95 %: {ends[0]} to {ends[1]} %, {_rests(place)}" if sure else _unsure(comparison, line, place)
    open_one = "; no change is shown" if sure and place.ratio.low <= 1 <= place.ratio.high else ""
    at = f"at {comparison.setting(place)}"
    first = f"{_value(comparison, line.first.value)} {display.key(comparison.key).unit}".rstrip()
    over = f"that at {comparison.setting(line.first) if any(map(names_scene, comparison.along)) else first}"
    before = f"{line.label}: " if line.label else ""
    return f"{before}{name} {at} is {_percent(place)} of {over} ({interval}){open_one}."


def _unsure(comparison: Against, line: Line, place: RatioPoint) -> str:
    """Reason that a ratio has no interval: one pair of runs, or one run at either value; with the remarks of points."""
    assert line.first is not None
    why = f"{_rests(place)}: no interval" if place.pairs else "one run: no interval"
    ends = [(one.value, one.result.remark) for one in (line.first, place) if one.result.remark]
    return "; ".join((why, *(f"at {_value(comparison, value)}: {remark}" for value, remark in ends)))


def _first(found: Against) -> str:
    firsts = {line.first.value for line in found.lines if line.first is not None}
    return display.setting(found.key, next(iter(firsts))) if len(firsts) == 1 else "the first value"


def _value(found: Against, value: float | str) -> str:
    return display.amount(found.key, value)


def _percent(place: RatioPoint) -> str:
    assert place.ratio is not None
    return f"{display.with_error(place.ratio.value, place.ratio.error, 100)} %"


def against_table(comparison: Against) -> Table:
    """Every point: the other keys, the key, the quantity, its ratio to that at the first value and on what it rests."""
    other_keys = list(dict.fromkeys(name for line in comparison.lines for name in line.at))
    notation = display.quantity(comparison.quantity)
    rows = []
    for line in comparison.lines:
        for place in line.places:
            at = (display.amount(name, line.at[name]) if name in line.at else "–" for name in other_keys)
            pooled = place.result.pooled.get(comparison.quantity)
            value = "–" if pooled is None else display.with_error(pooled.value, pooled.error, notation.scale)
            interval = "–" if pooled is None else display.percentage(pooled.relative)
            values = {**place.result.at, **place.result.along}
            along = (display.amount(name, values[name]) if name in values else "–" for name in comparison.along)
            rows.append(
                (
                    *at,
                    _value(comparison, place.value),
                    *along,
                    value,
                    interval,
                    *_ratio(place, line),
                    place.result.remark,
                )
            )
    keys = (*other_keys, comparison.key, *comparison.along)
    headings = (*(display.key(name).heading for name in keys), notation.heading, "95 % interval")
    last = len(headings) + 3
    ratio = figures.ratio_heading(comparison)
    notes = (
        "± is one standard error; intervals are 95 %, by Student’s t. Ratios are from pairs of runs that start from "
        "the same packing, so that its effect cancels, or from independent runs (Welch).",
    )
    text = frozenset({last} | {k for k, name in enumerate(keys) if _worded(comparison, name)})
    headings = (*headings, ratio, "95 % interval of the ratio", "rests on", "remarks")
    return Table(headings, tuple(rows), text, notes=notes)


def _worded(comparison: Against, name: str) -> bool:
    places = [place.result for line in comparison.lines for place in line.places]
    values = comparison.values if name == comparison.key else [{**one.at, **one.along}.get(name) for one in places]
    return any(isinstance(value, str) for value in values)


def _ratio(place: RatioPoint, line: Line) -> tuple[str, str, str]:
    if place is line.first:
        return "1", "–", "–"
    if place.ratio is None:
        return "–", "–", "–"
    ratio = place.ratio
    ends = (display.number(end, ratio.error) for end in (ratio.low, ratio.high))
    interval = " to ".join(ends) if math.isfinite(ratio.half_width) else "unknown"
    return display.with_error(ratio.value, ratio.error), interval, _rests(place)


def _rests(place: RatioPoint) -> str:
    return f"{place.pairs} pair{'' if place.pairs == 1 else 's'}" if place.pairs else "independent runs"


def against_caption(comparison: Against) -> str:
    """Caption of the figure of a quantity against a key."""
    name = display.quantity(comparison.quantity).name
    pairs = {place.pairs > 0 for line in comparison.lines for place in line.places if place.ratio is not None}
    how = {
        frozenset({True}): "from pairs of runs that start from the same packing",
        frozenset({False}): "of independent runs (Welch)",
    }.get(frozenset(pairs), "from pairs of runs that start from the same packing, or of independent runs (Welch)")
    ratios = [place.ratio for line in comparison.lines for place in line.places if place.ratio is not None]
    with_intervals = "with 95 % intervals " if any(math.isfinite(ratio.half_width) for ratio in ratios) else ""
    below = f" Below: over {name} at {_first(comparison)}, {with_intervals}{how}." if ratios else ""
    text = f"Above: {name} with 95 % intervals.{below}"
    places = [place.result for line in comparison.lines for place in line.places]
    pooled = [one.pooled[comparison.quantity] for one in places if comparison.quantity in one.pooled]
    open_ends = not all(math.isfinite(one.half_width) for one in (*pooled, *ratios))
    text += " Hollow: see the remarks in the table." if any(one.remark for one in places) else ""
    text += " Hollow with a dashed bar: the interval is unknown." if open_ends else ""
    text += f" Cross at the foot: no {name}." if len(pooled) < len(places) else ""
    if comparison.along:
        with_it = _listed([display.spoken(other) for other in comparison.along])
        text += f" {with_it} {'change' if len(comparison.along) > 1 else 'changes'} along."
    return text


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
