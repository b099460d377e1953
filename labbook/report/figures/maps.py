"""Maps in a plane through the axis of a silo: packing fraction, and the pressure that contacts carry."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.fields import Ring
from labbook.measure.stress import contact_pressure
from labbook.report.figures.pattern import draw_walls, even, row_height, top_of
from labbook.report.pattern import across, both
from labbook.report.style import MILLIMETRE, PAGE, house

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from labbook.fields import Fields
    from labbook.report.pattern import FlowPattern

_COLUMNS = 4


def packing_maps(found: Sequence[tuple["FlowPattern", "Fields | None"]]) -> "Figure":
    """Packing fraction of each point and, where contacts were recorded, their pressure below it; one scale a row."""
    from matplotlib.figure import Figure

    found = found[:_COLUMNS]
    stressed = any(stress is not None for _, stress in found)
    with house():
        top = top_of([one for one, _ in found])
        height = row_height([one for one, _ in found], top)
        figure = Figure(figsize=(PAGE * max(len(found), 2) / _COLUMNS, (8 + height * (1 + stressed)) * MILLIMETRE))
        axes = figure.subplots(1 + stressed, len(found), squeeze=False)
        phi = [_mirrored(one.fields, one.fields.packing_fraction, one.pattern.bed) for one, _ in found]
        _row(figure, axes[0], found, phi, r"packing fraction $\phi$", [one.result.label for one, _ in found], top)
        if stressed:
            pressures = [
                None if stress is None else _mirrored(stress, contact_pressure(stress), _bed(stress))
                for _, stress in found
            ]
            _row(figure, axes[1], found, pressures, "contact pressure [Pa]", [""] * len(found), top)
    return figure


def _bed(fields: "Fields") -> np.ndarray:
    from labbook.fields import pattern_of

    return pattern_of(fields).bed


def _mirrored(fields: "Fields", values: np.ndarray, bed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    assert isinstance(fields.grid, Ring)
    x, z = across(fields.grid)
    return even(x) * 1e3, even(z) * 1e3, both(np.where(bed, values, np.nan))


def _row(figure: "Figure", axes, found, maps, text: str, titles: Sequence[str], top: float) -> None:
    known = [values for one in maps if one is not None for values in one[2][np.isfinite(one[2])]]
    low, high = np.quantile(known, [0.005, 0.995])
    mesh = None
    for ax, (one, _), each, title in zip(axes, found, maps, titles, strict=True):
        ax.set_axis_off()
        ax.set_title(title)
        if each is not None:
            mesh = ax.pcolormesh(*each, cmap="viridis", vmin=low, vmax=high, shading="nearest", rasterized=True)
        draw_walls(ax, one, top)
    assert mesh is not None
    bar = figure.colorbar(mesh, ax=axes, shrink=0.8, aspect=24)
    bar.set_label(text)
