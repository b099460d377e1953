"""A study as a notebook shows it: a picture of its scene beside what was stated."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any

from labbook.study.point import Point

_LEFT_OUT = ("name", "about", "sweep", "points")
_LONGEST = 120
"""Characters of a value that are shown."""


def study_html(
    name: str,
    about: str,
    definition: Mapping[str, Any],
    points: Sequence[Point],
    replicates: int,
    discharges: int | str = 1,
) -> str:
    """The study as HTML: name, sentence, sweep and sections as they were written; the scene of the first point."""
    size_text = f"{_count(len(points), 'point')} × {_count(replicates, 'replicate')}"
    if isinstance(discharges, int):
        size_text += f" × {_count(discharges, 'discharge')}" if discharges > 1 else ""
        size_text += f" = {_count(len(points) * replicates * discharges, 'run')}"
    rows = [("points", size_text), *_swept(definition)]
    rows += [(key, _spelled(value)) for key, value in definition.items() if key not in _LEFT_OUT]
    lines = "".join(
        f'<tr><th style="text-align:left;vertical-align:top">{escape(key)}</th>'
        f'<td style="text-align:left">{escape(value)}</td></tr>'
        for key, value in rows
    )
    picture = points[0].scene.svg() if points else ""
    caption = f'<div style="text-align:center">{escape(points[0].label)}</div>' if len(points) > 1 else ""
    return (
        f"<div><b>{escape(name)}</b>{f': {escape(about)}' if about else ''}</div>"
        '<div style="display:flex;flex-wrap:wrap;gap:1.5em;align-items:flex-start">'
        f'<div>{picture}{caption}</div><table style="flex:1 1 20em;width:auto">{lines}</table></div>'
    )


def _swept(definition: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Swept keys with their values, as the study states them."""
    sweep, listed = definition.get("sweep"), definition.get("points")
    if isinstance(listed, Sequence) and not isinstance(listed, str):
        keys = dict.fromkeys(key for point in listed if isinstance(point, Mapping) for key in point)
        for key in keys:
            values = (point.get(key, "–") for point in listed if isinstance(point, Mapping))
            yield key, f"{_cut(', '.join(map(str, values)))}, point by point"
    if isinstance(sweep, Mapping):
        together = sweep.get("zip")
        grid = {key: value for key, value in sweep.items() if key != "zip"}
        yield from ((key, _spelled(value)) for key, value in grid.items())
        if isinstance(together, Mapping):
            yield from ((key, f"{_spelled(value)}, together") for key, value in together.items())


def _spelled(value: Any) -> str:
    """A value in one line, nearly as YAML has it."""
    return _cut(_flow(value))


def _flow(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_inner(one)}" for key, one in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(map(_inner, value))
    return str(value).lower() if isinstance(value, bool) else str(value)


def _inner(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{{{_flow(value)}}}"
    return f"[{_flow(value)}]" if isinstance(value, Sequence) and not isinstance(value, str) else _flow(value)


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"
