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
        labels = "; ".join(result.label for result in comparison.unset[:5])
        rest = f" and {len(comparison.unset) - 5} more" if len(comparison.unset) > 5 else ""
        blocks.append(Prose(f"Not shown, as {name} is not set: {labels}{rest}.", note=True))
    return Section(title, tuple(blocks))


def changes(comparison: Against) -> list[str]:
    """Sentences on where the quantity differs most from that at the first value: one a line; for many lines one, on the
    line that changes most and the one that changes least, or on those that rise and fall most."""
    name = display.quantity(comparison.quantity).name
    largest = [(line, point) for line in comparison.lines if (point := line.largest) is not None]
    if len(largest) <= _LISTED:
        return [_ratio_sentence(comparison, line, point, name) for line, point in largest]
    bounded = [(line, point) for line, point in largest if math.isfinite(_change(point).error)]
    unbounded = len(largest) - len(bounded)
    ranked = sorted(bounded or largest, key=lambda one: _change(one[1]).value)
    if _change(ranked[0][1]).value < 0:
        ends = [ranked[0], ranked[-1]]
    else:  # all rise: the largest change first
        ends = [ranked[-1], ranked[0]]
    phrases: list[str] = []
    for line, point in ends if len(ranked) > 1 else ends[:1]:
        phrase, span = _change_phrase(point), _span(comparison, line, point)
        if phrases and phrase.partition(" ")[0] == phrases[0].partition(" ")[0]:
            phrase = phrase.partition(" ")[2]
        span = "" if phrases and f" {span}" in phrases[0] else f" {span}"
        phrases.append(f"{phrase}{span}{f' at {line.label}' if line.label else ''}")
    without = (
        f" {unbounded} of {len(largest)} lines rest on one run and have no interval." if unbounded and bounded else ""
    )
    return [f"{name} {', '.join(phrases)}.{without}"]


def _change(ratio_point: RatioPoint) -> Pooled:
    """The change relative to the value at the first place of the line."""
    assert ratio_point.ratio is not None
    return replace(ratio_point.ratio, value=ratio_point.ratio.value - 1)


def _change_phrase(ratio_point: RatioPoint) -> str:
    """`falls by 41 ± 4 %`, or `does not change` where the interval holds zero."""
    change = _change(ratio_point)
    size = f"{display.with_error(abs(change.value), change.error, 100)} %"
    unsure = " (no change is shown)" if change.low <= 0 <= change.high else ""
    return f"{'falls' if change.value < 0 else 'rises'} by {size}{unsure if math.isfinite(change.error) else ''}"


def _span(comparison: Against, line: Line, ratio_point: RatioPoint) -> str:
    """`from 20 to 90 deg`: the two values that a change lies between; words with their key."""
    assert line.first is not None
    if comparison.words or any(map(names_scene, comparison.along)):
        return f"from {comparison.setting(line.first)} to {comparison.setting(ratio_point)}"
    ends = f"from {_value(comparison, line.first.value)} to {_value(comparison, ratio_point.value)}"
    unit = display.key(comparison.key).unit
    return f"{ends} {unit}" if unit else f"from {display.spoken(comparison.key)} {ends.removeprefix('from ')}"


def _ratio_sentence(comparison: Against, line: Line, ratio_point: RatioPoint, name: str) -> str:
    assert ratio_point.ratio is not None
    assert line.first is not None
    ends = [
        display.number(end, ratio_point.ratio.error, 100) for end in (ratio_point.ratio.low, ratio_point.ratio.high)
    ]
    sure = math.isfinite(ratio_point.ratio.half_width)
    interval = (
        f"95 %: {ends[0]} to {ends[1]} %, {_pairing(ratio_point)}" if sure else _unsure(comparison, line, ratio_point)
    )
    open_one = "; no change is shown" if sure and ratio_point.ratio.low <= 1 <= ratio_point.ratio.high else ""
    at = f"at {comparison.setting(ratio_point)}"
    first = f"{_value(comparison, line.first.value)} {display.key(comparison.key).unit}".rstrip()
    denominator = f"that at {comparison.setting(line.first) if any(map(names_scene, comparison.along)) else first}"
    before = f"{line.label}: " if line.label else ""
    return f"{before}{name} {at} is {_percent(ratio_point)} of {denominator} ({interval}){open_one}."


def _unsure(comparison: Against, line: Line, ratio_point: RatioPoint) -> str:
    """Reason that a ratio has no interval: one pair of runs, or one run at either value; with the remarks of points."""
    assert line.first is not None
    why = f"{_pairing(ratio_point)}: no interval" if ratio_point.pairs else "one run: no interval"
    ends = [(end.value, end.result.remark) for end in (line.first, ratio_point) if end.result.remark]
    return "; ".join((why, *(f"at {_value(comparison, value)}: {remark}" for value, remark in ends)))


def _first(found: Against) -> str:
    firsts = {line.first.value for line in found.lines if line.first is not None}
    return display.setting(found.key, next(iter(firsts))) if len(firsts) == 1 else "the first value"


def _value(found: Against, value: float | str) -> str:
    return display.amount(found.key, value)


def _percent(ratio_point: RatioPoint) -> str:
    assert ratio_point.ratio is not None
    return f"{display.with_error(ratio_point.ratio.value, ratio_point.ratio.error, 100)} %"


def against_table(comparison: Against) -> Table:
    """Every point: the other keys, the key, the quantity, its ratio to that at the first value and on what it rests."""
    other_keys = list(dict.fromkeys(name for line in comparison.lines for name in line.at))
    notation = display.quantity(comparison.quantity)
    rows = []
    for line in comparison.lines:
        for point in line.points:
            at = (display.amount(name, line.at[name]) if name in line.at else "–" for name in other_keys)
            pooled = point.result.pooled.get(comparison.quantity)
            value = "–" if pooled is None else display.with_error(pooled.value, pooled.error, notation.scale)
            interval = "–" if pooled is None else display.percentage(pooled.relative)
            values = {**point.result.at, **point.result.along}
            along = (display.amount(name, values[name]) if name in values else "–" for name in comparison.along)
            rows.append(
                (
                    *at,
                    _value(comparison, point.value),
                    *along,
                    value,
                    interval,
                    *_ratio(point, line),
                    point.result.remark,
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
    results = [point.result for line in comparison.lines for point in line.points]
    values = (
        comparison.values if name == comparison.key else [{**result.at, **result.along}.get(name) for result in results]
    )
    return any(isinstance(value, str) for value in values)


def _ratio(ratio_point: RatioPoint, line: Line) -> tuple[str, str, str]:
    if ratio_point is line.first:
        return "1", "–", "–"
    if ratio_point.ratio is None:
        return "–", "–", "–"
    ratio = ratio_point.ratio
    ends = (display.number(end, ratio.error) for end in (ratio.low, ratio.high))
    interval = " to ".join(ends) if math.isfinite(ratio.half_width) else "unknown"
    return display.with_error(ratio.value, ratio.error), interval, _pairing(ratio_point)


def _pairing(ratio_point: RatioPoint) -> str:
    return (
        f"{ratio_point.pairs} pair{'' if ratio_point.pairs == 1 else 's'}" if ratio_point.pairs else "independent runs"
    )


def against_caption(comparison: Against) -> str:
    """Caption of the figure of a quantity against a key."""
    name = display.quantity(comparison.quantity).name
    pairs = {point.pairs > 0 for line in comparison.lines for point in line.points if point.ratio is not None}
    how = {
        frozenset({True}): "from pairs of runs that start from the same packing",
        frozenset({False}): "of independent runs (Welch)",
    }.get(frozenset(pairs), "from pairs of runs that start from the same packing, or of independent runs (Welch)")
    ratios = [point.ratio for line in comparison.lines for point in line.points if point.ratio is not None]
    with_intervals = "with 95 % intervals " if any(math.isfinite(ratio.half_width) for ratio in ratios) else ""
    below = f" Below: over {name} at {_first(comparison)}, {with_intervals}{how}." if ratios else ""
    text = f"Above: {name} with 95 % intervals.{below}"
    results = [point.result for line in comparison.lines for point in line.points]
    pooled = [result.pooled[comparison.quantity] for result in results if comparison.quantity in result.pooled]
    open_ends = not all(math.isfinite(number.half_width) for number in (*pooled, *ratios))
    text += " Hollow: see the remarks in the table." if any(result.remark for result in results) else ""
    text += " Hollow with a dashed bar: the interval is unknown." if open_ends else ""
    text += f" Cross at the foot: no {name}." if len(pooled) < len(results) else ""
    if comparison.along:
        with_it = _listed([display.spoken(other) for other in comparison.along])
        text += f" {with_it} {'change' if len(comparison.along) > 1 else 'changes'} along."
    return text


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
