"""Many curves in a figure: few have a legend, more are parted into panels by one swept key and coloured by another."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from labbook.report.style import DASHES, MARKERS, legend_columns, look, mathtext, verbatim
from labbook.results import display

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

ENTRIES = 6
"""Entries of a legend at most."""
_LIGHTEST = 0.88  # of the colour map: its last colours vanish on white
_TICKS = 8  # of a colour bar
_DECADES = 30  # ratio of the ends of a colour bar, beyond which it is logarithmic


@dataclass(frozen=True)
class Arrangement:
    """Panels, styles and legend of the curves of a figure.

    Args:
        panels: Numbers of the curves by the title of their panel.
        looks: Colour, marker and dash of each curve.
        ranks: Rank of each curve among those of its panel.
        entries: Legend: style by label.
        bar: Name and values of the key of a colour bar, which replaces a long legend.
    """

    panels: Mapping[str, tuple[int, ...]]
    looks: tuple[dict[str, Any], ...]
    ranks: tuple[int, ...]
    entries: Mapping[str, dict[str, Any]]
    bar: tuple[str, tuple[float, ...]] | None = None

    @property
    def together(self) -> int:
        """Largest number of curves in one panel."""
        return max(self.ranks, default=0) + 1

    def rows(self, width: float) -> int:
        """Number of lines that the legend takes in a figure of this width [inch]."""
        return math.ceil(len(self.entries) / legend_columns(tuple(self.entries), width)) if self.entries else 0

    def explain(self, figure: "Figure", **shape: Any) -> None:
        """Add the legend above the axes, or the colour bar beside them. `shape`: options of curves in the legend."""
        from matplotlib.lines import Line2D

        if self.entries:
            handles = [Line2D([], [], **{**style, **shape}) for style in self.entries.values()]
            names = [mathtext(verbatim(name)) for name in self.entries]
            columns = legend_columns(names, figure.get_figwidth())
            figure.legend(handles, names, loc="outside upper center", ncols=columns)
        if self.bar is not None:
            key, values = self.bar
            notation = display.key(key)
            bar = figure.colorbar(_colours(key, values), ax=figure.axes, shrink=0.8, aspect=30, pad=0.02)
            ticks = values[:: math.ceil(len(values) / _TICKS)]
            bar.set_ticks([value * notation.scale for value in ticks], labels=[display.amount(key, v) for v in ticks])
            bar.minorticks_off()
            bar.set_label(mathtext(notation.heading))


def arranged(ats: Sequence[Mapping[str, float | str]], labels: Sequence[str]) -> Arrangement:
    """Arrange curves at these swept values, with these labels.

    Up to `ENTRIES` of them share a panel and have a legend. More are coloured by the key of numbers that takes most
    values, with a panel for each combination of the others: a legend names up to `ENTRIES` values, a colour bar more.
    Curves that differ in no key of numbers have a panel each.
    """
    values = {key: {at.get(key) for at in ats} for key in dict.fromkeys(key for at in ats for key in at)}
    varied = {key: some for key, some in values.items() if len(some) > 1}
    numbers = {key: some for key, some in varied.items() if all(isinstance(value, int | float) for value in some)}
    if len(ats) <= ENTRIES:
        looks = tuple(look(k) for k in range(len(ats)))
        entries = {label: looks[k] for k, label in enumerate(labels) if label or len(ats) > 1}
        entries = {label or "without the others": style for label, style in entries.items()}
        return Arrangement({"": tuple(range(len(ats)))}, looks, tuple(range(len(ats))), entries)
    if not numbers:
        panels = {label: (k,) for k, label in enumerate(labels)}
        return Arrangement(panels, tuple(look(0) for _ in ats), tuple(0 for _ in ats), {})
    key = max(numbers, key=lambda name: len(numbers[name]))
    order = sorted(float(value) for value in numbers[key] if value is not None)
    panels: dict[str, tuple[int, ...]] = {}
    for k, at in enumerate(ats):
        title = display.label({name: at[name] for name in varied if name in at and name != key})
        panels[title] = (*panels.get(title, ()), k)
    ranks = tuple(order.index(float(at[key])) for at in ats)
    if len(order) <= ENTRIES:
        entries = {display.setting(key, value): look(rank) for rank, value in enumerate(order)}
        return Arrangement(panels, tuple(look(rank) for rank in ranks), ranks, entries)
    colours = _colours(key, order)
    scale = display.key(key).scale
    styles = [
        {
            "color": tuple(colours.to_rgba(np.array([value * scale]))[0]),
            "marker": MARKERS[k % len(MARKERS)],
            "linestyle": DASHES[0],
        }
        for k, value in enumerate(order)
    ]
    return Arrangement(panels, tuple(styles[rank] for rank in ranks), ranks, {}, (key, tuple(order)))


def _colours(key: str, values: Sequence[float]) -> "ScalarMappable":
    """A map of colours over the values of a key, as they are shown; logarithmic where they span decades."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, LogNorm, Normalize

    scaled = [value * display.key(key).scale for value in values]
    low, high = min(scaled), max(scaled)
    norm = LogNorm(low, high) if low > 0 and high / low > _DECADES else Normalize(low, high)
    part = [colormaps["viridis"](_LIGHTEST * step / 255) for step in range(256)]
    return ScalarMappable(norm, ListedColormap(part))
