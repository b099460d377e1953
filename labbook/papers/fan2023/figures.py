"""Figures of Fan et al. (2023): profiles along outlets, their middles, their shape against the position of the outlet
(Figs 4, 7, 8a, 11 and 13 to 15a), and flow rates over that of a plain hopper."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.papers.fan2023.laws import (
    TERMS,
    Approach,
    Saturation,
    approach_at,
    centred_flow,
    eccentric_flow,
    middle_speed,
    tilted,
)
from labbook.papers.fan2023.profiles import Curve, FittedOutlet, ProfileFit, approaches, profile_fit
from labbook.papers.fan2023.ratios import ANGLE, GAP, RATIOS, Ratio, angle_factors, angle_laws, authors
from labbook.report.style import (
    COLOURS,
    COLUMN,
    DASHES,
    FAINT,
    INK,
    MILLIMETRE,
    PAGE,
    band,
    beside_title,
    from_zero,
    house,
    legend_columns,
    look,
    mathtext,
    verbatim,
)
from labbook.results import display
from labbook.results.reference import Comparison, of_reference
from labbook.results.series import Series
from labbook.stats import Pooled

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ACROSS = np.linspace(-1, 1, 401)
_MIDDLE_SYMBOLS = {"velocity": "v_c", "area_fraction": "phi_c"}


def outlet_profiles(
    series: Series, definition: str, comparisons: Sequence[Comparison] = (), source: str = ""
) -> "Figure":
    """Plot v(x) and phi(x) above, v/v_c and phi/phi_c below with the fitted dome.

    A colour an outlet; bands: one standard error over seeds; faint: bins that are not fitted; dots: the reference.
    """
    from matplotlib.figure import Figure

    fit = profile_fit(series, definition)
    with house():
        figure = Figure(figsize=(PAGE, 118 * MILLIMETRE))
        axes = figure.subplots(2, 2, sharex="row")
        for index, (result, fitted) in enumerate(zip(fit.points, fit.outlets, strict=True)):
            label = f"D = {result.orifice * 1e3:g} mm"
            for column, name in enumerate(_MIDDLE_SYMBOLS):
                runs = np.array([getattr(outlet, name) for outlet in result.outlets(definition)])
                _draw_profile(axes[0, column], fitted, name, runs, 1.0, fitted.profile.R * 1e3, index, label)
                centre = getattr(fitted, _MIDDLE_SYMBOLS[name]).value
                _draw_profile(axes[1, column], fitted, name, runs, centre, 1.0, index, label)
        for column, exponent in enumerate(fit.exponents):
            name = "ab"[column]
            shape = f"$(1-x^{{*2}})^{{{name}}}$, {name} = {exponent:.3g}"
            axes[1, column].plot(_ACROSS, tilted(_ACROSS, exponent), color=INK, linewidth=0.9, zorder=1, label=shape)
            curve = fit.curves[("tilted_" if _tilts(fit) else "") + list(_MIDDLE_SYMBOLS)[column]]
            _bands(axes[1, column], curve, curve.at, INK)
            axes[1, column].set_xlabel(r"$x^* = (x-e)/R$")
            axes[0, column].set_xlabel(r"$x-e$ [mm]")
            theirs = of_reference(comparisons, definition, series)
            curves = axes[1, column].lines[-1:] + _tilted(axes[1, column], column, fit)
            curves += _their_profile(axes[1, column], column, theirs, source)
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
    """True if the tilt of the velocity is larger than two standard errors."""
    return abs(fit.parameters["delta1"].value) > 2 * fit.parameters["delta1"].error


def _tilted(ax: "Axes", column: int, fit: ProfileFit) -> list:
    """Plot the tilted curve of eqs 16 and 17, if the tilt of the velocity is significant."""
    if not _tilts(fit):
        return []
    curve = fit.curves["tilted_" + list(_MIDDLE_SYMBOLS)[column]]
    delta = display.number(fit.parameters[_TILTED[column][0]].value, fit.parameters[_TILTED[column][0]].error)
    label = f"eq {16 + column}, {'δ₁' if column == 0 else 'δ₂'} = {delta}"
    return ax.plot(curve.at, curve.value, color=INK, linestyle=(0, (6, 2)), linewidth=0.9, zorder=1, label=label)


def _their_profile(ax: "Axes", column: int, theirs: Mapping[str, float], source: str) -> list:
    """Plot the reference's dome, or its tilted curve."""
    style = {**_DOTS, "label": verbatim(source)}
    exponent = "ab"[column]
    if exponent in theirs:
        return ax.plot(_ACROSS, tilted(_ACROSS, theirs[exponent]), **style)
    if theirs.keys() >= set(_TILTED[column]):
        delta, epsilon, sigma = (theirs[name] for name in _TILTED[column])
        return ax.plot(_ACROSS, tilted(_ACROSS, sigma, delta / epsilon), **style)
    return []


def _draw_profile(
    ax: "Axes", fitted: FittedOutlet, name: str, runs: np.ndarray, unit: float, scale: float, index: int, label: str
) -> None:
    profile, style = fitted.profile, look(index)
    x = (profile.edges[1:] + profile.edges[:-1]) / 2 * scale
    y = getattr(profile, name) / unit
    inside = profile.inside & np.isfinite(y)
    ax.plot(x, y, color=style["color"], alpha=0.3, linewidth=0.7, zorder=1)
    if len(runs) > 1:
        error = runs.std(axis=0, ddof=1) / math.sqrt(len(runs)) / unit
        ax.fill_between(x, y - error, y + error, where=inside, color=style["color"], alpha=0.2, linewidth=0)
    style = {**style, "linestyle": "none", "markersize": 3}
    ax.plot(x[inside], y[inside], **style, label=label, zorder=2)


def outlet_middles(
    series: Series, definition: str, comparisons: Sequence[Comparison] = (), source: str = ""
) -> "Figure":
    """Plot v_c against sqrt(R), phi_c against R, and the flow rate from profiles over the counted one.

    Lines: sqrt(2 g gamma R) and eq 12; bars: one standard error; bands: 95 %, of the law and of one more outlet; dots:
    the law with the reference's parameters.
    """
    from matplotlib.figure import Figure

    fit = profile_fit(series, definition)
    R = np.array([outlet.profile.R for outlet in fit.outlets])
    with house():
        figure = Figure(figsize=(PAGE, 60 * MILLIMETRE))
        left, middle, right = figure.subplots(1, 3)
        theirs = of_reference(comparisons, definition, series)
        _speeds(left, fit, R, series.points[0].point.scene.gravity, theirs, source)
        _middles(middle, fit, R, theirs, source)
        for index, (name, label) in enumerate(_FLOWS.items()):
            style = {**look(index), "linestyle": "none"}
            flows = [getattr(outlet, name) for outlet in fit.outlets]
            offset = 0.4 * (index - (len(_FLOWS) - 1) / 2)
            values, errors = [flow.value for flow in flows], [np.nan_to_num(flow.error) for flow in flows]
            right.errorbar(2e3 * R + offset, values, yerr=errors, label=label, **style)
        right.axhline(1, color=FAINT, linewidth=0.6, zorder=0)
        right.set_xlabel("orifice, $D$ [mm]")
        right.set_ylabel("flow of the profiles / $W$ counted")
        right.legend(loc="best")
        if series.label:
            figure.suptitle(series.label, x=0.01, ha="left", fontsize=7.5)
    return figure


_FLOWS = {"direct": "integral", "centred": "eq 14, own φ", "printed": "eq 14 as printed", "eccentric": "eq 18"}


def _speeds(ax: "Axes", fit: ProfileFit, R: np.ndarray, g: float, theirs: Mapping[str, float], source: str) -> None:
    curve = fit.curves["v_c"]
    x = np.sqrt(curve.at * 1e3)
    ax.plot(x, curve.value, color=COLOURS[1], label=f"γ = {fit.parameters['gamma'].value:.3g}")
    _bands(ax, curve, x, COLOURS[1])
    if "gamma" in theirs:
        ax.plot(
            x,
            middle_speed(theirs["gamma"], curve.at, g),
            label=f"{verbatim(source)}, γ = {theirs['gamma']:.3g}",
            **_DOTS,
        )
    values, errors = (
        [outlet.v_c.value for outlet in fit.outlets],
        [np.nan_to_num(outlet.v_c.error) for outlet in fit.outlets],
    )
    ax.errorbar(np.sqrt(R * 1e3), values, yerr=errors, color=INK, marker="o", linestyle="none")
    from_zero(ax)
    ax.set_xlabel(r"$\sqrt{R}$ [mm$^{1/2}$]")
    ax.set_ylabel("$v_c$ [m/s]")
    ax.legend(loc="upper left")


def _middles(ax: "Axes", fit: ProfileFit, R: np.ndarray, theirs: Mapping[str, float], source: str) -> None:
    values, errors = (
        [outlet.phi_c.value for outlet in fit.outlets],
        [np.nan_to_num(outlet.phi_c.error) for outlet in fit.outlets],
    )
    ax.errorbar(R * 1e3, values, yerr=errors, color=INK, marker="o", linestyle="none")
    if "phi_c" in fit.curves:
        curve, limit = fit.curves["phi_c"], fit.parameters["phi_inf"].value
        x = curve.at * 1e3
        ax.plot(x, curve.value, color=COLOURS[1], label=f"eq 12, $φ_∞$ = {limit:.3g}")
        _bands(ax, curve, x, COLOURS[1])
        if theirs.keys() & {"phi_inf", "tau1"}:
            law = Saturation(theirs.get("phi_inf", limit), theirs.get("tau1", 0.0), theirs.get("tau2", 0.0))
            ax.plot(
                x,
                law.at(curve.at),
                label=verbatim(source) if "tau1" in theirs else f"{verbatim(source)}, $φ_∞$",
                **_DOTS,
            )
        ax.legend(loc="lower right")
    ax.set_xlabel("$R$ [mm]")
    ax.set_ylabel(r"$\phi_c$")


_DOTS = {"color": INK, "linestyle": ":", "linewidth": 1.2, "zorder": 3}


def _bands(ax: "Axes", curve: Curve, x: np.ndarray, colour: str) -> None:
    """Draw the intervals of a law and of one more point, if there are seeds enough for any."""
    if np.isfinite(curve.point).all():
        law, point = ((curve.value - half, curve.value + half) for half in (curve.law, curve.point))
        band(ax, x, law, point, colour)


def outlets_of_all(
    series: Sequence[Series], definition: str, comparisons: Sequence[Comparison] = (), source: str = ""
) -> "Figure":
    """Plot v_c against sqrt(R), phi_max against R and W against R, a colour a series, with 95 % intervals.

    Solid lines: sqrt(2 g gamma R), eq 12, and the flow rate that follows from the profiles of a series (eq 18; without
    tilt eq 14). Dots: the same with the reference's parameters. Series that differ in a second key have a row of their
    own.
    """
    from matplotlib.figure import Figure

    fitted = [line for line in series if definition in line.further]
    key = _varied(fitted)
    rows = list(dict.fromkeys(line.label_without(key) for line in fitted))
    labels = list(dict.fromkeys(_label_of(line, key) for line in fitted))
    with house():
        figure = Figure(figsize=(PAGE, (18 + 58 * len(rows)) * MILLIMETRE))
        axes = figure.subplots(len(rows), 3, squeeze=False, sharex="col")
        for line in fitted:
            row, style = rows.index(line.label_without(key)), look(labels.index(_label_of(line, key)))
            _draw_outlets(
                axes[row], line, definition, of_reference(comparisons, definition, line), style, _label_of(line, key)
            )
        for ax_row, title in zip(axes, rows, strict=True):
            ax_row[0].set_title(title)
            for ax, text in zip(ax_row, ("$v_c$ [m/s]", r"$\phi_{max}$", "$W$ [g/s]"), strict=True):
                ax.set_ylabel(text)
            for ax in ax_row[[0, 2]]:
                from_zero(ax)
        for ax, text in zip(axes[-1], (r"$\sqrt{R}$ [mm$^{1/2}$]", "$R$ [mm]", "$R$ [mm]"), strict=True):
            ax.set_xlabel(text)
        handles = dict(zip(*reversed(_handles(axes)), strict=True))
        if any(
            of_reference(comparisons, definition, line).keys() & {"gamma", "epsilon1", "phi_inf"} for line in fitted
        ):
            (dots,) = axes[0, 0].plot([], [], color=INK, linestyle=":")
            handles[source] = dots
        figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=min(len(handles), 6))
        figure.align_ylabels()
    return figure


def _varied(series: Sequence[Series]) -> str:
    """Name the swept key with most values, which the colours show."""
    values = {name: {line.at.get(name) for line in series} for line in series for name in line.at}
    return max(values, key=lambda name: len(values[name]), default="")


def _label_of(series: Series, key: str) -> str:
    if key in series.at:
        return display.setting(key, series.at[key])
    return f"{display.key(key).name} not set" if key else "labbook"


def _handles(axes: np.ndarray) -> tuple[list, list[str]]:
    legends = [ax.get_legend_handles_labels() for ax in axes[:, 0]]
    return [h for handles, _ in legends for h in handles], [text for _, labels in legends for text in labels]


def _draw_outlets(
    axes: Sequence["Axes"], series: Series, definition: str, theirs: "Mapping[str, float]", style: dict, label: str
) -> None:
    fit = profile_fit(series, definition)
    R = np.array([outlet.profile.R for outlet in fit.outlets])
    fine = np.linspace(0.9 * R.min(), 1.05 * R.max(), 120)
    scene = series.points[0].point.scene
    ours = {name: parameter.value for name, parameter in fit.parameters.items()}
    speeds, covers = ([getattr(outlet, name) for outlet in fit.outlets] for name in ("v_c", "phi_max"))
    flows = [result.flow_rate for result in fit.points]
    for ax, x, numbers, scale in zip(
        axes, (np.sqrt(R * 1e3), R * 1e3, R * 1e3), (speeds, covers, flows), (1.0, 1.0, 1e3), strict=True
    ):
        points = [(at, number) for at, number in zip(x, numbers, strict=True) if number is not None]
        _bars(ax, points, scale, {**style, "linestyle": "none", "label": label})
    for parameters, line in ((ours, "-"), ({**_limit(theirs, ours), **theirs}, ":")):
        if parameters is not ours and not theirs:
            continue
        line_style = {"color": style["color"], "linestyle": line, "linewidth": 0.9, "zorder": 1}
        gamma = parameters.get("gamma", parameters.get("epsilon1", np.nan) ** 2)
        axes[0].plot(np.sqrt(fine * 1e3), middle_speed(gamma, fine, scene.gravity), **line_style)
        if parameters.keys() >= {"phi_inf", "tau1", "tau2"}:
            law = Saturation(parameters["phi_inf"], parameters["tau1"], parameters["tau2"])
            axes[1].plot(fine * 1e3, law.at(fine), **line_style)
        elif "phi_inf" in parameters and parameters is not ours:
            axes[1].axhline(parameters["phi_inf"], **line_style)
        flow = _flow(parameters, fine, scene.grains.diameter, scene.grains.density, scene.gravity)
        if flow is not None:
            axes[2].plot(fine * 1e3, 1e3 * flow, **line_style)


def _limit(theirs: "Mapping[str, float]", ours: "Mapping[str, float]") -> dict[str, float]:
    """Our phi_inf, where a reference has tau1 and tau2 but not phi_inf."""
    return {"phi_inf": ours["phi_inf"]} if "tau1" in theirs and "phi_inf" in ours else {}


def _bars(ax: "Axes", points: Sequence[tuple[float, Pooled]], scale: float, style: dict) -> None:
    half = [number.half_width if np.isfinite(number.half_width) else 0.0 for _, number in points]
    values = [number.value * scale for _, number in points]
    ax.errorbar([at for at, _ in points], values, yerr=np.array(half) * scale, markersize=3.5, **style)


def _flow(p: "Mapping[str, float]", R: np.ndarray, d: float, rho: float, g: float) -> np.ndarray | None:
    """W [kg/s] by eq 18 (centred profiles of a reference: by eq 14), with eq 12 if it was fitted, else phi_inf."""
    if "phi_inf" not in p:
        return None
    limit = Saturation(p["phi_inf"], p.get("tau1", 0.0), p.get("tau2", 0.0)).at(R)
    if p.keys() >= {"delta1", "epsilon1", "sigma1", "delta2", "epsilon2", "sigma2"}:
        speed = p["delta1"], p["epsilon1"], p["sigma1"]
        cover = p["delta2"], p["epsilon2"], p["sigma2"]
        flows = [eccentric_flow(d, rho, g, r, phi, speed, cover) for r, phi in zip(R, limit, strict=True)]
    elif p.keys() >= {"a", "b", "gamma"}:
        speeds = middle_speed(p["gamma"], R, g)
        flows = [centred_flow(d, rho, phi, v, r, p["a"], p["b"]) for r, phi, v in zip(R, limit, speeds, strict=True)]
    else:
        return None
    return np.array(flows)


def shape_against_position(
    ratios: Sequence[Ratio], definition: str, comparisons: Sequence[Comparison] = (), source: str = ""
) -> "Figure":
    """Plot tilts and exponents of each point's own profiles (eqs 16, 17) against s*, with standard errors over seeds.

    Lines: limit - depth e^{-rate s*} with its 95 % bands, fitted to the points of each panel; dots: the reference.
    """
    from matplotlib.figure import Figure

    with house():
        figure = Figure(figsize=(PAGE, 122 * MILLIMETRE))
        axes = figure.subplots(2, 2, sharex=True).flatten()
        for ax, (name, approached) in zip(axes, approaches(ratios, definition).items(), strict=True):
            groups = [display.label(result.at, {GAP}) for result in approached.of]
            order = list(dict.fromkeys(groups))
            for index, parameter, group in zip(approached.positions, approached.parameters, groups, strict=True):
                style = {**look(order.index(group)), "linestyle": "none", "markersize": 3.5}
                error = parameter.error if math.isfinite(parameter.error) else 0.0
                label = group if group not in ax.get_legend_handles_labels()[1] else None
                ax.errorbar(index, parameter.value, yerr=error, label=label, **style)
            if approached.approach is not None:
                _draw_approach(ax, approached.approach)
            theirs = {c.quantity.rpartition(".")[2]: c.reference for c in comparisons
                      if c.quantity.rpartition(".")[0] == f"{definition}.{name}"}  # fmt: skip
            if theirs.keys() >= set(TERMS):
                _their_approach(ax, theirs, source)
            ax.set_ylabel(display.quantity(f"{definition}.{name}").name.partition(" ")[0])
        handles: dict = {}
        for ax in axes:
            handles |= {text: handle for handle, text in zip(*ax.get_legend_handles_labels(), strict=True)}
        for ax in axes[2:]:
            ax.set_xlabel("distance from the wall, $s^* = 2s/(L-D)$")
        figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=4)
        figure.align_ylabels()
    return figure


_PLACES = np.linspace(0, 1, 400)


def _draw_approach(ax: "Axes", law: Approach) -> None:
    value = law.at(_PLACES)
    ax.plot(_PLACES, value, color=COLOURS[1], zorder=1)
    if not all(map(math.isfinite, law.errors)):
        ax.set_title("rate of the approach: not determined")
        return
    halves = (law.half_width(_PLACES), law.half_width(_PLACES, new_point=True))
    law_band, point_band = ((value - half, value + half) for half in halves)
    band(ax, _PLACES, law_band, point_band, COLOURS[1])
    limit, depth, rate = (
        display.with_error(value, error)
        for value, error in zip((law.limit, law.depth, law.rate), law.errors, strict=True)
    )
    ax.set_title(f"{limit} − ({depth}) exp(−({rate}) s*)")


def _their_approach(ax: "Axes", theirs: Mapping[str, float], source: str) -> None:
    curve = approach_at(_PLACES, *(theirs[name] for name in TERMS))
    ax.plot(_PLACES, curve, color=INK, linestyle=":", linewidth=1.2, zorder=3, label=verbatim(source))


def flow_against_angle(ratios: Sequence[Ratio]) -> "Figure":
    """Plot W(angle)/W(90 deg) of every outlet, with the angle factors of Brown and of Rose and Tanaka.

    Bars: 95 % intervals; below, the distance of the points from each law.
    """
    from matplotlib.figure import Figure

    laws = {law.name: law for ratio in ratios for law in angle_laws(ratio.result)}
    colours = _colours_of_laws(ratios)
    names = authors(ratios)
    low = min(ratio.at for ratio in ratios)
    angles = np.linspace(0.9 * low, math.pi / 2, 200)
    with house():
        figure = Figure(figsize=(COLUMN, (66 + 26 * len(names)) * MILLIMETRE))
        axes = figure.subplots(1 + len(names), 1, sharex=True, height_ratios=(2.6, *[1] * len(names)))
        for author, below, dash in zip(names, axes[1:], DASHES, strict=False):
            for k, law in enumerate(law for law in laws.values() if law.author == author):
                curve, coloured = [law.factor(a) for a in angles], law.name in colours
                how = {"linestyle": dash, "linewidth": 1.0 if coloured else 1.5 / (1 + k)}
                name = mathtext(law.name) if not coloured else None if k else author
                axes[0].plot(np.degrees(angles), curve, color=colours.get(law.name, INK), label=name, **how)
            below.axhline(0, color=INK, linestyle=dash, linewidth=0.8, zorder=0)
            compared = [ratio for ratio in ratios if author in angle_factors(ratio)]
            _points(below, compared, ANGLE, math.degrees, lambda ratio, author=author: angle_factors(ratio)[author])
            below.set_ylabel(f"from\n{author} [%]", fontsize=6.5)
        _points(axes[0], ratios, ANGLE, math.degrees)
        axes[-1].set_xlabel("angle of the bottom from the vertical, α [deg]")
        axes[0].set_ylabel("$W(α) / W(90°)$")
        labels = axes[0].get_legend_handles_labels()[1]
        legend = figure.legend(
            *axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=legend_columns(labels, COLUMN)
        )
        for line in legend.get_lines()[: len(names)]:
            line.set_color(INK)
        figure.align_ylabels()
    return figure


def _colours_of_laws(ratios: Sequence[Ratio]) -> dict[str, str]:
    """Colours of laws of which an author has several, those of their points; none where points of several looks share
    a law."""
    groups = list(dict.fromkeys(_group(ratio, ANGLE) for ratio in ratios))
    of: dict[str, set[str]] = {}
    for ratio in ratios:
        for law in angle_laws(ratio.result):
            of.setdefault(law.name, set()).add(_group(ratio, ANGLE))
    rivals = {name for name in of if sum(name.partition(",")[0] == other.partition(",")[0] for other in of) > 1}
    if any(len(of[name]) > 1 for name in rivals):
        return {}
    return {name: look(groups.index(next(iter(of[name]))))["color"] for name in rivals}


def _group(ratio: Ratio, key: str) -> str:
    """Label of the points that share a look."""
    return display.label(ratio.result.at, {key})


def flow_against_position(
    ratios: Sequence[Ratio], comparisons: Sequence[Comparison] = (), source: str = ""
) -> "Figure":
    """Plot W over that of an outlet in the middle against s*, with 95 % intervals; diamonds: the reference."""
    from matplotlib.figure import Figure

    with house():
        figure = Figure(figsize=(PAGE * 0.75, 72 * MILLIMETRE))
        ax = figure.subplots()
        _points(ax, ratios, GAP, float)
        position_of = {tuple(ratio.result.at.items()): ratio.at for ratio in ratios}
        theirs = [c for c in comparisons if c.quantity in RATIOS and tuple(c.at.items()) in position_of]
        if theirs:
            x = [position_of[tuple(c.at.items())] for c in theirs]
            style = {"marker": "D", "markersize": 6, "markerfacecolor": "none", "linestyle": "none", "zorder": 4}
            ax.plot(x, [c.reference for c in theirs], color=INK, label=verbatim(source), **style)
        ax.axhline(1, color=FAINT, linewidth=0.6, zorder=0)
        ax.set_ylim(*_range(ratios))
        ax.set_xlabel("distance from the wall, $s^* = 2s/(L-D)$")
        ax.set_ylabel("$W / W$ in the middle")
        figure.legend(loc="outside right upper")
    return figure


def _range(ratios: Sequence[Ratio]) -> tuple[float, float]:
    """Range of all values with their intervals, cut where an interval is so wide that it would hide the values."""
    values = [ratio.value for ratio in ratios]
    wide = 0.5 * (max(values) - min(values)) or 0.1
    low = min(max(ratio.low, ratio.value - wide) for ratio in ratios)
    high = max(min(ratio.high, ratio.value + wide) for ratio in ratios)
    return low - 0.05 * (high - low), high + 0.05 * (high - low)


def _points(
    ax: "Axes",
    ratios: Sequence[Ratio],
    key: str,
    scale: Callable[[float], float],
    law: Callable[[Ratio], float] | None = None,
) -> None:
    """Plot ratios, an outlet a colour, side by side where they coincide; with a `law`, their distance from it [%]."""
    groups = list(dict.fromkeys(_group(ratio, key) for ratio in ratios))
    span = float(np.ptp([scale(ratio.at) for ratio in ratios])) or 1.0
    for index, group in enumerate(groups):
        own = sorted((ratio for ratio in ratios if _group(ratio, key) == group), key=lambda ratio: ratio.at)
        offset = 0.005 * span * (index - (len(groups) - 1) / 2)
        style = {**look(index), "linestyle": "none", "markersize": 3.5}
        x, y, bars = [], [], []
        for ratio in own:
            expected = law(ratio) if law else 1.0
            per_cent = 100 / expected if law else 1.0
            x.append(scale(ratio.at) + offset)
            y.append((ratio.value - (expected if law else 0.0)) * per_cent)
            ends = [ratio.value - ratio.low, ratio.high - ratio.value]
            bars.append([end * per_cent if math.isfinite(end) else 0.0 for end in ends])
        ax.errorbar(x, y, yerr=np.transpose(bars), label=group, **style)
