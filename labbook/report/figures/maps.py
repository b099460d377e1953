"""Maps in a plane through the axis of a silo: packing fraction and speed at several instants, stress, orientation."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.fields import Fields, Ring, pattern_of
from labbook.measure.stress import contact_pressure
from labbook.report.figures.pattern import draw_means, draw_walls, even, row_height, speed_of, top_of
from labbook.report.style import MILLIMETRE, PAGE, house
from labbook.results.recorded import Flowing, across, both
from labbook.results.rotation import turning_at

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLUMNS = 4
Map = tuple[np.ndarray, np.ndarray, np.ndarray]
"""x and z [mm], and values, shape [z, x]."""


def packing_maps(rows: Sequence[Sequence[Flowing]]) -> "Figure":
    """Packing fraction, a row a point, a column an instant."""
    from matplotlib.colors import Normalize

    maps = {id(one): _mirrored(one.fields, one.fields.packing_fraction, one.pattern.bed) for row in rows for one in row}
    norm = Normalize(*_range(maps.values()))

    def draw(ax: "Axes", one: Flowing) -> None:
        _mesh(ax, maps[id(one)], norm)

    return _instants(rows, draw, norm, r"packing fraction $\phi$")


def speed_maps(rows: Sequence[Sequence[Flowing]]) -> "Figure":
    """Speed in the plane with streamlines, a row a point, a column an instant; hatched: what stands."""
    from matplotlib.colors import PowerNorm

    sections = {id(one): one.section() for row in rows for one in row}
    highest = max(float(np.nanpercentile(speed_of(section), 99.5)) for section in sections.values())
    norm = PowerNorm(0.5, 0.0, highest)

    def draw(ax: "Axes", one: Flowing) -> None:
        draw_means(ax, sections[id(one)], norm)

    return _instants(rows, draw, norm, "speed [m/s]")


def pressure_maps(found: Sequence[tuple[Flowing, Fields]]) -> "Figure":
    """A third of the trace of the contact stress, a column a point."""
    maps = [_mirrored(stress, contact_pressure(stress), pattern_of(stress).bed) for _, stress in found]
    return _points([one for one, _ in found], [("contact pressure [Pa]", maps)])


def order_maps(patterns: Sequence[Flowing]) -> "Figure":
    """Of rods O_zz and, below, the order S: the largest eigenvalue of the orientation tensor; a column a point."""

    def maps(of: Callable[[Fields], np.ndarray]) -> list[Map]:
        return [_mirrored(one.fields, of(one.fields), one.pattern.bed) for one in patterns]

    upright = maps(lambda fields: fields.orientation[2, 2])
    return _points(patterns, [("$O_{zz}$", upright), ("order $S$", maps(lambda fields: fields.nematic_order))])


def _points(patterns: Sequence[Flowing], rows: Sequence[tuple[str, Sequence[Map]]]) -> "Figure":
    """Means over the window: a column a point; a row, with a scale of its own, a quantity."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    patterns = patterns[:_COLUMNS]
    top = top_of(patterns)
    with house():
        height = 8 + len(rows) * row_height(patterns, top)
        figure = Figure(figsize=(PAGE * min(1, (len(patterns) + 0.5) / _COLUMNS), height * MILLIMETRE))
        axes = figure.subplots(len(rows), len(patterns), squeeze=False)
        for line, (text, maps) in zip(axes, rows, strict=True):
            norm = Normalize(*_range(maps[:_COLUMNS]))
            for ax, one, each in zip(line, patterns, maps, strict=False):
                ax.set_title(turning_at(one.result))
                _mesh(ax, each, norm)
                draw_walls(ax, one, top)
            figure.colorbar(ScalarMappable(norm, "viridis"), ax=line, shrink=0.9).set_label(text)
    return figure


def _instants(rows: Sequence[Sequence[Flowing]], draw: Callable[["Axes", Flowing], None], norm, text: str) -> "Figure":
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

    patterns = [one for row in rows for one in row]
    top, columns = top_of(patterns), max(map(len, rows))
    with house():
        height = 8 + len(rows) * row_height(patterns, top)
        figure = Figure(figsize=(PAGE * (columns + 0.4) / _COLUMNS, height * MILLIMETRE))
        axes = figure.subplots(len(rows), columns, squeeze=False)
        for ax in axes.flat:
            ax.set_axis_off()
        for line, row in zip(axes, rows, strict=True):
            for ax, one in zip(line, row, strict=False):
                draw(ax, one)
                draw_walls(ax, one, top)
                begin, end = one.window
                ax.set_title(f"{turning_at(one.result)}, t = {begin:.3g} to {end:.3g} s", fontsize=6)
        bar = figure.colorbar(ScalarMappable(norm, "viridis"), ax=axes, shrink=0.6, aspect=40)
        bar.set_label(text)
    return figure


def _mirrored(fields: Fields, values: np.ndarray, bed: np.ndarray) -> Map:
    assert isinstance(fields.grid, Ring)
    x, z = across(fields.grid)
    return even(x) * 1e3, even(z) * 1e3, both(np.where(bed, values, np.nan))


def _range(maps) -> tuple[float, float]:
    known = np.concatenate([values[np.isfinite(values)] for _, _, values in maps])
    low, high = np.quantile(known, [0.005, 0.995])
    return float(low), float(high)


def _mesh(ax: "Axes", each: Map, norm) -> None:
    ax.pcolormesh(*each, cmap="viridis", norm=norm, shading="nearest", rasterized=True)
