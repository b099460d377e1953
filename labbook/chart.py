"""Small charts in SVG, by which a notebook shows curves and points without a plotting library."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

_WIDTH, _HEIGHT = 480, 220  # pixels
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 10, 8, 40  # pixels of margins
_TICKS = 5  # intervals between ticks, about
_LINE, _MARK, _QUIET = "#1f77b4", "#d55e00", "#888"


@dataclass
class Chart:
    """A chart from zero on its vertical axis.

    Attributes:
        across: Heading of the horizontal axis.
        upwards: Heading of the vertical axis.
        ends: Smallest and largest value on the horizontal axis.
        top: Largest value on the vertical axis.
    """

    across: str
    upwards: str
    ends: tuple[float, float]
    top: float
    _parts: list[str] = field(default_factory=list)

    def shade(self, low: float, high: float) -> None:
        """Shade the whole height between two values of the horizontal axis."""
        left, right = self._x(low), self._x(high)
        self._parts.append(
            f'<rect x="{left:.1f}" y="{_TOP}" width="{right - left:.1f}" height="{_HEIGHT - _TOP - _BOTTOM}" '
            'fill="#8883"/>'
        )

    def band(self, x: Sequence[float], low: Sequence[float], high: Sequence[float]) -> None:
        """Fill the band between two curves; where an end is unknown there is none."""
        rows = [row for row in zip(x, low, high, strict=True) if all(map(math.isfinite, row))]
        outline = [(a, b) for a, b, _ in rows] + [(a, c) for a, _, c in reversed(rows)]
        if outline:
            self._parts.append(f'<polygon points="{self._points(outline)}" fill="{_LINE}33"/>')

    def curve(self, x: Sequence[float], y: Sequence[float]) -> None:
        """Draw a line through points."""
        pairs = [pair for pair in zip(x, y, strict=True) if all(map(math.isfinite, pair))]
        self._parts.append(
            f'<polyline points="{self._points(pairs)}" fill="none" stroke="{_LINE}" stroke-width="1.5"/>'
        )

    def point(self, x: float, y: float, low: float, high: float, hollow: bool = False) -> None:
        """Draw a point with its interval."""
        at, up, (bottom, top) = self._x(x), self._y(y), (self._y(low), self._y(high))
        fill = "none" if hollow else _MARK
        self._parts.append(
            f'<path d="M{at:.1f} {bottom:.1f}V{top:.1f}" stroke="{_MARK}" stroke-width="1.5"/>'
            f'<circle cx="{at:.1f}" cy="{up:.1f}" r="3.5" fill="{fill}" stroke="{_MARK}" stroke-width="1.5"/>'
        )

    def svg(self) -> str:
        """Return the chart as SVG, which follows the colour of text of its page."""
        right, floor = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM
        axes = [f'<path d="M{_LEFT} {_TOP}V{floor}H{right}" fill="none" stroke="{_QUIET}"/>']
        for value in ticks(*self.ends):
            at = self._x(value)
            axes.append(f'<path d="M{at:.1f} {floor}v4" stroke="{_QUIET}"/>')
            axes.append(_text(at, floor + 16, f"{value:g}", "middle"))
        for value in ticks(0.0, self.top):
            up = self._y(value)
            axes.append(f'<path d="M{_LEFT} {up:.1f}h-4" stroke="{_QUIET}"/>')
            axes.append(_text(_LEFT - 7, up + 4, f"{value:g}", "end"))
        axes.append(_text((_LEFT + right) / 2, _HEIGHT - 6, self.across, "middle"))
        middle = (_TOP + floor) / 2
        axes.append(_text(12, middle, self.upwards, "middle", f' transform="rotate(-90 12 {middle:g})"'))
        return (
            f'<svg width="{_WIDTH}" height="{_HEIGHT}" viewBox="0 0 {_WIDTH} {_HEIGHT}" fill="currentColor" '
            f'font-family="sans-serif" font-size="11">{"".join(self._parts)}{"".join(axes)}</svg>'
        )

    def _x(self, value: float) -> float:
        low, high = self.ends
        return _LEFT + (value - low) / ((high - low) or 1.0) * (_WIDTH - _LEFT - _RIGHT)

    def _y(self, value: float) -> float:
        fraction = min(max(value / (self.top or 1.0), 0.0), 1.0)  # what is above the chart ends at its edge
        return _TOP + (1 - fraction) * (_HEIGHT - _TOP - _BOTTOM)

    def _points(self, pairs: Sequence[tuple[float, float]]) -> str:
        return " ".join(f"{self._x(x):.1f},{self._y(y):.1f}" for x, y in pairs)


def ticks(low: float, high: float) -> list[float]:
    """Choose multiples of 1, 2 or 5 times a power of ten between two values.

    Args:
        low: Smaller value.
        high: Larger value.

    Returns:
        Multiples in the range, some five of them; only `low` where the range is empty.
    """
    if not high > low:
        return [low]
    raw = (high - low) / _TICKS
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= raw * (1 - 1e-9))
    return [step * k for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def _text(x: float, y: float, text: str, anchor: str, more: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{more}>{escape(text)}</text>'
