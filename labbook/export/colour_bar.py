"""Colours of grains in recordings: speed on a square-root scale, kinds by hue, and a bar with their meaning."""

import io
import math
from collections.abc import Sequence

import numpy as np

from labbook.picture import KIND_COLOURS

BACKGROUND = (244, 245, 247)
"""Colour behind grains and bars."""

_WIDTH, _ROW, _TEXT = 900, 16, 54  # pixels: of a bar, height of a row of it, room for ticks and title below
_LABEL = 130  # pixels left and right of a bar
_DARKEST = 0.15  # of viridis: on darker grains shades cannot be seen, and a bed at rest is one blot
_APART = 0.06  # of a bar's width: least distance of two numbers


def speed_colours(speed: np.ndarray, top_speed: float) -> np.ndarray:
    """Colour speeds on a square-root scale from 0 (dark) to the top speed (yellow).

    The square root keeps slow zones, at a few per cent of the outlet's speed, apart from those at rest.

    Args:
        speed: Speeds [m/s], shape [n].
        top_speed: Speed at the upper end of the scale [m/s].

    Returns:
        RGBA bytes, shape [n, 4].
    """
    from matplotlib import colormaps

    return colormaps["viridis"](_DARKEST + (1 - _DARKEST) * _fraction(speed, top_speed), bytes=True)


def kind_colours(kind: np.ndarray, speed: np.ndarray, top_speed: float) -> np.ndarray:
    """Colour grains by kind, two thirds white at the top speed and beyond.

    Speeds count by their square roots, as in `speed_colours`.

    Args:
        kind: Places in `grains.kinds`, shape [n].
        speed: Speeds [m/s], shape [n].
        top_speed: Speed at the upper end of the scale [m/s].

    Returns:
        RGBA bytes, shape [n, 4].
    """
    plain = KIND_COLOURS[kind % len(KIND_COLOURS)]
    mixed = plain + (255 - plain) * (_fraction(speed, top_speed) * 2 / 3)[:, None]
    return np.column_stack([mixed, np.full(len(kind), 255)]).astype(np.uint8)


def colour_bar(kinds: Sequence[str], top_speed: float) -> bytes:
    """Draw the bar of colours from 0 to the top speed.

    Args:
        kinds: Names of the kinds, a row for each; one row without kinds.
        top_speed: Speed at the upper end of the scale [m/s].

    Returns:
        Picture (PNG).
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fraction = np.linspace(0, 1, 256)
    if kinds:
        rows = [kind_colours(np.full(256, k), fraction**2, 1.0) for k in range(len(kinds))]
    else:
        rows = [speed_colours(fraction**2, 1.0)]
    height, width = _ROW * len(rows) + _TEXT, _WIDTH + 2 * _LABEL
    figure = Figure((width / 100, height / 100), dpi=200, facecolor="#{:02x}{:02x}{:02x}".format(*BACKGROUND))
    FigureCanvasAgg(figure)
    bar = figure.add_axes(
        (_LABEL / width, 1 - (_ROW * len(rows) + 6) / height, _WIDTH / width, _ROW * len(rows) / height)
    )
    bar.imshow(np.stack(rows), aspect="auto", extent=(0, 1, len(rows), 0), interpolation="nearest")
    unit, name = (1.0, "m/s") if top_speed >= 0.1 or top_speed <= 0 else (1e-3, "mm/s")
    speeds = speed_ticks(top_speed)
    labels = [f"{speed / unit:.3g}" for speed in speeds]
    labels[-1] = f"≥ {two_digits(top_speed / unit)}" if top_speed > 0 else labels[-1]
    bar.set_xticks(_fraction(np.array(speeds), top_speed), labels, fontsize=9)
    bar.set_yticks(np.arange(len(kinds)) + 0.5, kinds, fontsize=9)
    bar.tick_params(length=3, left=False)
    bar.set_xlabel(f"speed [{name}]", fontsize=9, labelpad=1)
    stored = io.BytesIO()
    figure.savefig(stored, format="png", facecolor=figure.get_facecolor())
    return stored.getvalue()


def two_digits(value: float) -> str:
    """Format a number with two digits and without an exponent where it can: 150, 0.12, 1e-07."""
    return f"{float(f'{value:.2g}'):g}"


def speed_ticks(top_speed: float) -> list[float]:
    """Choose ticks that are far enough apart on the square-root scale to be read.

    Args:
        top_speed: Speed at the upper end of the scale [m/s].

    Returns:
        0, round speeds, and `top_speed` [m/s].
    """
    if top_speed <= 0:
        return [0.0]
    decade = math.floor(math.log10(top_speed))
    ticks = [0.0]
    for speed in (m * 10.0**k for k in (decade - 2, decade - 1, decade) for m in (1, 2, 5)):
        before, here = (math.sqrt(v / top_speed) for v in (ticks[-1], speed))
        if here - before >= _APART and 1 - here >= _APART:
            ticks.append(speed)
    return [*ticks, top_speed]


def _fraction(speed: np.ndarray, top_speed: float) -> np.ndarray:
    """Place on the scale, 0 to 1."""
    return np.sqrt(np.clip(speed / top_speed, 0, 1)) if top_speed > 0 else np.zeros(len(speed))
