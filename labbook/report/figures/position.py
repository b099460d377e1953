"""The shape of profiles against the relative distance of the outlet from the wall (Fan et al. 2023, Figs 11 and 14)."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.fit.outlet import fit_approach, fit_profiles
from labbook.report import display
from labbook.report.ratios import GAP
from labbook.report.series import context
from labbook.report.style import COLOURS, MILLIMETRE, PAGE, house, look

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from labbook.report.ratios import Ratio

_SHAPE = {"delta1": "δ₁", "sigma1": "σ₁", "delta2": "δ₂", "sigma2": "σ₂"}


def shape_against_position(ratios: Sequence["Ratio"], definition: str) -> "Figure":
    """Tilts and exponents of each point's own profiles (eqs 16, 17) against s*, with standard errors over seeds.

    Lines: limit - depth e^{-rate s*} with its 95 % band, fitted to the points of each panel.
    """
    from matplotlib.figure import Figure

    shown = [one for one in ratios if one.result.outlets(definition)]
    groups = list(dict.fromkeys(display.label(one.result.at, {GAP}) for one in shown))
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in _SHAPE}
    with house():
        figure = Figure(figsize=(PAGE, 122 * MILLIMETRE))
        axes = figure.subplots(2, 2, sharex=True).flatten()
        for one in shown:
            outlets = [one.result.outlets(definition)]
            parameters = fit_profiles(outlets, context([one.result])).parameters
            group = display.label(one.result.at, {GAP})
            style = {**look(groups.index(group)), "linestyle": "none", "markersize": 3.5}
            for ax, name in zip(axes, _SHAPE, strict=True):
                parameter = parameters[name]
                error = parameter.error if math.isfinite(parameter.error) else 0.0
                label = group if all(g != group for g in ax.get_legend_handles_labels()[1]) else None
                ax.errorbar(one.at, parameter.value, yerr=error, label=label, **style)
                found[name].append((one.at, parameter.value, parameter.error))
        handles = axes[0].get_legend_handles_labels()
        for ax, name in zip(axes, _SHAPE, strict=True):
            _approach(ax, found[name])
            ax.set_ylabel(_SHAPE[name])
        for ax in axes[2:]:
            ax.set_xlabel("distance from the wall, $s^* = 2s/(L-D)$")
        figure.legend(*handles, loc="outside upper center", ncols=4)
        figure.align_ylabels()
    return figure


def _approach(ax: "Axes", points: Sequence[tuple[float, float, float]]) -> None:
    s, values, _ = np.array(points).T
    if len(set(s)) < 4:
        return
    law = fit_approach(s.tolist(), values.tolist())
    fine = np.linspace(0, 1, 400)
    ax.plot(fine, law.at(fine), color=COLOURS[1], zorder=1)
    if not all(map(math.isfinite, law.errors)):
        ax.set_title("rate of the approach: not determined")
        return
    half = law.half_width(fine)
    ax.fill_between(fine, law.at(fine) - half, law.at(fine) + half, color=COLOURS[1], alpha=0.18, linewidth=0)
    limit, depth, rate = (
        display.with_error(value, error)
        for value, error in zip((law.limit, law.depth, law.rate), law.errors, strict=True)
    )
    ax.set_title(f"{limit} − ({depth}) exp(−({rate}) s*)")
