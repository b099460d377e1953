"""Profiles along the outlets of a series: as measured, laid over each other, and their middles against the width."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.fit.outlet import Curve, FittedOutlet, ProfileFit, Saturation, middle_speed, tilted
from labbook.report.style import (
    COLOURS,
    FAINT,
    INK,
    MILLIMETRE,
    PAGE,
    band,
    beside_title,
    from_zero,
    house,
    look,
    verbatim,
)
from labbook.results import display
from labbook.results.reference import Comparison, of_reference
from labbook.results.series import Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_FINE = np.linspace(-1, 1, 401)
_SHOWN = {"velocity": "v_c", "area_fraction": "phi_c"}


def outlet_profiles(
    series: Series, definition: str, comparisons: Sequence[Comparison] = (), source: str = ""
) -> "Figure":
    """v(x) and phi(x) above, v/v_c and phi/phi_c below with the fitted dome; an outlet a colour, bands of one standard
    error over seeds. Faint: bins that are not fitted. Dots: the reference's curves.
    """
    from matplotlib.figure import Figure

    fit = series.profiles[definition]
    with house():
        figure = Figure(figsize=(PAGE, 118 * MILLIMETRE))
        axes = figure.subplots(2, 2, sharex="row")
        for index, (result, one) in enumerate(zip(series.profiled, fit.outlets, strict=True)):
            label = f"D = {result.orifice * 1e3:g} mm"
            for column, name in enumerate(_SHOWN):
                runs = np.array([getattr(outlet, name) for outlet in result.outlets(definition)])
                _draw(axes[0, column], one, name, runs, 1.0, one.profile.R * 1e3, index, label)
                centre = getattr(one, _SHOWN[name]).value
                _draw(axes[1, column], one, name, runs, centre, 1.0, index, label)
        for column, exponent in enumerate(fit.exponents):
            name = "ab"[column]
            shape = f"$(1-x^{{*2}})^{{{name}}}$, {name} = {exponent:.3g}"
            axes[1, column].plot(_FINE, tilted(_FINE, exponent), color=INK, linewidth=0.9, zorder=1, label=shape)
            curve = fit.curves[("tilted_" if _tilts(fit) else "") + list(_SHOWN)[column]]
            _bands(axes[1, column], curve, curve.at, INK)
            axes[1, column].set_xlabel(r"$x^* = (x-e)/R$")
            axes[0, column].set_xlabel(r"$x-e$ [mm]")
            known = of_reference(comparisons, definition, series)
            curves = axes[1, column].lines[-1:] + _tilted(axes[1, column], column, fit)
            curves += _theirs(axes[1, column], column, known, source)
            axes[1, column].legend(handles=curves, loc="lower center")
        for ax, text in zip(axes.flat, ("$v$ [m/s]", r"$\phi$", "$v/v_c$", r"$\phi/\phi_c$"), strict=True):
            ax.set_ylabel(text)
            from_zero(ax)
        figure.legend(
            *axes[0, 0].get_legend_handles_labels(), loc=beside_title(series.label), ncols=min(8, len(fit.outlets))
        )
        if series.label:
            figure.suptitle(series.label, x=0.01, ha="left", fontsize=7.5)
        figure.align_ylabels()
    return figure


_TILTED = (("delta1", "epsilon1", "sigma1"), ("delta2", "epsilon2", "sigma2"))


def _tilts(fit: ProfileFit) -> bool:
    """Whether the velocity is tilted by more than chance."""
    return abs(fit.parameters["delta1"].value) > 2 * fit.parameters["delta1"].error


def _tilted(ax: "Axes", column: int, fit: ProfileFit) -> list:
    """The tilted curve of eqs 16 and 17, where the tilt of the velocity is significant."""
    if not _tilts(fit):
        return []
    curve = fit.curves["tilted_" + list(_SHOWN)[column]]
    delta = display.number(fit.parameters[_TILTED[column][0]].value, fit.parameters[_TILTED[column][0]].error)
    label = f"eq {16 + column}, {'δ₁' if column == 0 else 'δ₂'} = {delta}"
    return ax.plot(curve.at, curve.value, color=INK, linestyle=(0, (6, 2)), linewidth=0.9, zorder=1, label=label)


def _theirs(ax: "Axes", column: int, known: Mapping[str, float], source: str) -> list:
    """The reference's dome, or its tilted curve."""
    style = {**_DOTS, "label": verbatim(source)}
    exponent = "ab"[column]
    if exponent in known:
        return ax.plot(_FINE, tilted(_FINE, known[exponent]), **style)
    if known.keys() >= set(_TILTED[column]):
        delta, epsilon, sigma = (known[name] for name in _TILTED[column])
        return ax.plot(_FINE, tilted(_FINE, sigma, delta / epsilon), **style)
    return []


def _draw(
    ax: "Axes", one: FittedOutlet, name: str, runs: np.ndarray, over: float, scale: float, index: int, label: str
) -> None:
    profile, style = one.profile, look(index)
    x = (profile.edges[1:] + profile.edges[:-1]) / 2 * scale
    y = getattr(profile, name) / over
    inside = profile.inside & np.isfinite(y)
    ax.plot(x, y, color=style["color"], alpha=0.3, linewidth=0.7, zorder=1)
    if len(runs) > 1:
        error = runs.std(axis=0, ddof=1) / math.sqrt(len(runs)) / over
        ax.fill_between(x, y - error, y + error, where=inside, color=style["color"], alpha=0.2, linewidth=0)
    style = {**style, "linestyle": "none", "markersize": 3}
    ax.plot(x[inside], y[inside], **style, label=label, zorder=2)


def outlet_middles(
    series: Series, definition: str, comparisons: Sequence[Comparison] = (), source: str = ""
) -> "Figure":
    """v_c against sqrt(R) with sqrt(2 g gamma R), phi_c against R with eq 12, and the flow that profiles come to.

    Bands: 95 %, of the law and of one more outlet; dots: the law with the reference's parameters.
    """
    from matplotlib.figure import Figure

    fit = series.profiles[definition]
    R = np.array([one.profile.R for one in fit.outlets])
    with house():
        figure = Figure(figsize=(PAGE, 60 * MILLIMETRE))
        left, middle, right = figure.subplots(1, 3)
        known = of_reference(comparisons, definition, series)
        _speeds(left, fit, R, series.points[0].point.scene.gravity, known, source)
        _middles(middle, fit, R, known, source)
        for place, (name, label) in enumerate(_FLOWS.items()):
            style = {**look(place), "linestyle": "none"}
            flows = [getattr(one, name) for one in fit.outlets]
            offset = 0.4 * (place - (len(_FLOWS) - 1) / 2)
            values, errors = [one.value for one in flows], [np.nan_to_num(one.error) for one in flows]
            right.errorbar(2e3 * R + offset, values, yerr=errors, label=label, **style)
        right.axhline(1, color=FAINT, linewidth=0.6, zorder=0)
        right.set_xlabel("orifice, $D$ [mm]")
        right.set_ylabel("flow of the profiles / $W$ counted")
        right.legend(loc="best")
        if series.label:
            figure.suptitle(series.label, x=0.01, ha="left", fontsize=7.5)
    return figure


_FLOWS = {"direct": "integral", "centred": "eq 14, own φ", "printed": "eq 14 as printed", "eccentric": "eq 18"}


def _speeds(ax: "Axes", fit: ProfileFit, R: np.ndarray, g: float, known: Mapping[str, float], source: str) -> None:
    curve = fit.curves["v_c"]
    x = np.sqrt(curve.at * 1e3)
    ax.plot(x, curve.value, color=COLOURS[1], label=f"γ = {fit.parameters['gamma'].value:.3g}")
    _bands(ax, curve, x, COLOURS[1])
    if "gamma" in known:
        ax.plot(
            x, middle_speed(known["gamma"], curve.at, g), label=f"{verbatim(source)}, γ = {known['gamma']:.3g}", **_DOTS
        )
    values, errors = [one.v_c.value for one in fit.outlets], [np.nan_to_num(one.v_c.error) for one in fit.outlets]
    ax.errorbar(np.sqrt(R * 1e3), values, yerr=errors, color=INK, marker="o", linestyle="none")
    from_zero(ax)
    ax.set_xlabel(r"$\sqrt{R}$ [mm$^{1/2}$]")
    ax.set_ylabel("$v_c$ [m/s]")
    ax.legend(loc="upper left")


def _middles(ax: "Axes", fit: ProfileFit, R: np.ndarray, known: Mapping[str, float], source: str) -> None:
    values, errors = [one.phi_c.value for one in fit.outlets], [np.nan_to_num(one.phi_c.error) for one in fit.outlets]
    ax.errorbar(R * 1e3, values, yerr=errors, color=INK, marker="o", linestyle="none")
    if "phi_c" in fit.curves:
        curve, limit = fit.curves["phi_c"], fit.parameters["phi_inf"].value
        x = curve.at * 1e3
        ax.plot(x, curve.value, color=COLOURS[1], label=f"eq 12, $φ_∞$ = {limit:.3g}")
        _bands(ax, curve, x, COLOURS[1])
        if known.keys() & {"phi_inf", "tau1"}:
            law = Saturation(known.get("phi_inf", limit), known.get("tau1", 0.0), known.get("tau2", 0.0))
            ax.plot(
                x,
                law.at(curve.at),
                label=verbatim(source) if "tau1" in known else f"{verbatim(source)}, $φ_∞$",
                **_DOTS,
            )
        ax.legend(loc="lower right")
    ax.set_xlabel("$R$ [mm]")
    ax.set_ylabel(r"$\phi_c$")


_DOTS = {"color": INK, "linestyle": ":", "linewidth": 1.2, "zorder": 3}


def _bands(ax: "Axes", curve: Curve, x: np.ndarray, colour: str) -> None:
    """The intervals of a law and of one more point, where there are seeds enough for any."""
    if np.isfinite(curve.point).all():
        law, point = ((curve.value - half, curve.value + half) for half in (curve.law, curve.point))
        band(ax, x, law, point, colour)
