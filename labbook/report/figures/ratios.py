"""Flow rates over that of a plain hopper, against the angle of the bottom and against the position of the outlet."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.fit import Context
from labbook.fit.angle import brown, rose_tanaka
from labbook.fit.outlet import fit_approach, fit_profiles
from labbook.report import display
from labbook.report.ratios import ANGLE, GAP
from labbook.report.style import COLOURS, COLUMN, FAINT, INK, MILLIMETRE, PAGE, house, look

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from labbook.report.ratios import Ratio

_SHAPE = {"delta1": "δ₁", "sigma1": "σ₁", "delta2": "δ₂", "sigma2": "σ₂"}


def flow_against_angle(ratios: Sequence["Ratio"]) -> "Figure":
    """W(angle)/W(90 deg) of every outlet, with the angle factors of Brown and of Rose and Tanaka."""
    from matplotlib.figure import Figure

    friction = math.atan(ratios[0].result.point.scene.contact.friction)
    low = min(one.at for one in ratios)
    angles = np.linspace(0.9 * low, math.pi / 2, 200)
    with house():
        figure = Figure(figsize=(COLUMN, 70 * MILLIMETRE))
        ax = figure.subplots()
        ax.plot(np.degrees(angles), [brown(a) for a in angles], color=INK, label="Brown")
        label = f"Rose & Tanaka, φ_d = {math.degrees(friction):.3g}°"
        ax.plot(np.degrees(angles), [rose_tanaka(a, friction) for a in angles], color=INK, linestyle="--", label=label)
        _points(ax, ratios, ANGLE, math.degrees)
        ax.set_xlabel("angle of the bottom from the vertical, α [deg]")
        ax.set_ylabel("$W(α) / W(90°)$")
        ax.legend(loc="upper right")
    return figure


def flow_against_position(ratios: Sequence["Ratio"]) -> "Figure":
    """W over that of an outlet in the middle against s*; where profiles were measured, their tilts and exponents too.

    Lines: limit - depth e^{-rate s*}, fitted to the points of each panel.
    """
    from matplotlib.figure import Figure

    shown = [one for one in ratios if one.result.outlets]
    with house():
        figure = Figure(figsize=(PAGE if shown else COLUMN, (112 if shown else 66) * MILLIMETRE))
        axes = figure.subplots(2, 3).flatten() if shown else [figure.subplots()]
        _points(axes[0], ratios, GAP, float)
        axes[0].axhline(1, color=FAINT, linewidth=0.6, zorder=0)
        axes[0].set_ylabel("$W / W$ in the middle")
        if shown:
            _shapes(axes[1:5], shown)
            axes[5].set_axis_off()
            axes[5].legend(*axes[0].get_legend_handles_labels(), loc="center", ncols=1 + len(axes[0].containers) // 7)
        else:
            axes[0].legend()
        for ax in axes[:5]:
            ax.set_xlabel("$s^* = 2s/(L-D)$")
    return figure


def _points(ax: "Axes", ratios: Sequence["Ratio"], key: str, scale) -> None:
    groups = list(dict.fromkeys(display.label(one.result.at, {key}) for one in ratios))
    for place, group in enumerate(groups):
        mine = sorted((one for one in ratios if display.label(one.result.at, {key}) == group), key=lambda one: one.at)
        style = {**look(place), "linestyle": "none"}
        errors = [np.nan_to_num(one.error) for one in mine]
        ax.errorbar([scale(one.at) for one in mine], [one.value for one in mine], yerr=errors, label=group, **style)


def _shapes(axes: Sequence["Axes"], ratios: Sequence["Ratio"]) -> None:
    groups = list(dict.fromkeys(display.label(one.result.at, {GAP}) for one in ratios))
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in _SHAPE}
    for one in ratios:
        scene = one.result.point.scene
        context = Context(scene.grains.diameter, scene.grains.density, None, math.nan, scene.gravity)
        parameters = fit_profiles([one.result.outlets], context).parameters
        style = {**look(groups.index(display.label(one.result.at, {GAP}))), "linestyle": "none"}
        for ax, name in zip(axes, _SHAPE, strict=True):
            parameter = parameters[name]
            error = parameter.error if math.isfinite(parameter.error) else 0.0
            ax.errorbar(one.at, parameter.value, yerr=error, **style)
            found[name].append((one.at, parameter.value, parameter.error))
    fine = np.linspace(0, 1, 200)
    for ax, (name, shown) in zip(axes, _SHAPE.items(), strict=True):
        s, values, errors = np.array(found[name]).T
        ax.set_ylabel(shown)
        if len(set(s)) >= 4 and np.isfinite(errors).all() and (errors > 0).all():
            # the errors of single points, of few seeds, are too noisy for weights: all points alike
            law = fit_approach(s.tolist(), values.tolist(), [1.0] * len(s))
            text = f"{law.limit:.2g} − {law.depth:.2g} exp(−{law.rate:.3g} s*)".replace("− -", "+ ")
            ax.plot(fine, law.at(fine), color=COLOURS[1], label=text)
            ax.legend(loc="best")
