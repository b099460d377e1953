"""W(t) of runs as a picture, whole or up to a time, with the windows of their means shaded."""

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from labbook.export.colour_bar import BACKGROUND

if TYPE_CHECKING:
    from PIL.Image import Image

QUIET = (96, 104, 116)
"""Colour of axes and of text beside pictures."""
COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167))
"""Colours of the curves of runs side by side."""
_MARGINS = (52, 12, 14, 38)  # pixels around the axes: left, right, above, below
_LEGEND = 14  # pixels more above the axes of several curves
_OPAQUE, _PALE = "22", "30"  # of 255, in hexadecimal: of the area below a curve, and of a window


class FlowCurve(NamedTuple):
    """Flow rate W(t) of a run.

    Attributes:
        time: Times [s], shape [n].
        rate: Rates [g/s], shape [n].
        name: Name of the run.
        window: Begin and end of the window of the mean [s].
    """

    time: np.ndarray
    rate: np.ndarray
    name: str = ""
    window: tuple[float, float] | None = None


class FlowChart:
    """Chart of W(t) of runs that grows up to a time `end` [s], in a picture of `width` x `height` pixels."""

    def __init__(self, curves: Sequence[FlowCurve], end: float, width: int, height: int):
        self._curves, self._end = curves, end or 1.0
        self.width, self.height = width, height
        self._left, self._right = _MARGINS[0], width - _MARGINS[1]

    def at(self, time: float) -> "Image":
        """Draw the curves up to a time [s]."""
        x = round(self._left + min(time / self._end, 1.0) * (self._right - self._left))
        chart = self._axes.copy()
        chart.paste(self._whole.crop((0, 0, x, self.height)), (0, 0))
        return chart

    def with_mark(self, time: float) -> "Image":
        """Draw the whole curves with a line at a time [s]."""
        from PIL import ImageDraw

        x = round(self._left + min(time / self._end, 1.0) * (self._right - self._left))
        chart = self._whole.copy()
        ImageDraw.Draw(chart).line([(x, _MARGINS[2]), (x, self.height - _MARGINS[3])], QUIET, 2)
        return chart

    @cached_property
    def _axes(self) -> "Image":
        return self._render(whole=False)

    @cached_property
    def _whole(self) -> "Image":
        return self._render(whole=True)

    def _render(self, whole: bool) -> "Image":
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from PIL import Image

        left, right, above, below = _MARGINS
        several = len(self._curves) > 1
        above += _LEGEND if several else 0
        width, height, quiet = self.width, self.height, hexadecimal(QUIET)
        figure = Figure((width / 100, height / 100), dpi=100, facecolor=hexadecimal(BACKGROUND))
        canvas = FigureCanvasAgg(figure)
        box = left / width, below / height, (width - left - right) / width, (height - above - below) / height
        axes = figure.add_axes(box, facecolor="white")
        for number, curve in enumerate(self._curves):
            colour = hexadecimal(COLOURS[number % len(COLOURS)])
            if curve.window is not None:
                axes.axvspan(*curve.window, color=f"{colour if several else quiet}{_PALE}", linewidth=0)
            if whole:
                if not several:
                    axes.fill_between(curve.time, curve.rate, color=f"{colour}{_OPAQUE}", linewidth=0)
                axes.plot(curve.time, curve.rate, color=colour, linewidth=1.6, label=curve.name)
        top = max(float(curve.rate.max()) for curve in self._curves)
        axes.set(xlim=(0, self._end), ylim=(0, 1.08 * top or 1.0))
        axes.set_xlabel("t [s]", fontsize=9, color=quiet)
        axes.set_ylabel("W [g/s]", fontsize=9, color=quiet)
        axes.tick_params(labelsize=8, colors=quiet, length=3)
        if whole and several:
            axes.legend(
                fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0, 1), ncols=len(self._curves),
                borderaxespad=0.2,
            )  # fmt: skip
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        for side in ("left", "bottom"):
            axes.spines[side].set_color(quiet)
        canvas.draw()
        return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def hexadecimal(colour: tuple[int, int, int]) -> str:
    """Write an RGB colour as `#rrggbb`."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
