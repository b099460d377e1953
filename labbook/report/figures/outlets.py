"""Middles of profiles and flow rates of all series together (Fan et al. 2023, Figs 4, 7, 8a, 13 and 15a)."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.fit.outlet import Saturation, middle_speed
from labbook.fit.outlet.flow import centred_flow, eccentric_flow
from labbook.report.style import INK, MILLIMETRE, PAGE, from_zero, house, look
from labbook.results import display
from labbook.results.reference import Comparison, of_reference
from labbook.results.series import Series
from labbook.stats import Pooled

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def outlets_of_all(
    series: Sequence[Series], definition: str, comparisons: Sequence[Comparison] = (), source: str = ""
) -> "Figure":
    """v_c against sqrt(R), phi_max against R and W against R, a colour a series, with 95 % intervals.

    Solid lines: sqrt(2 g gamma R), eq 12, and the flow that the profiles of a series come to with them (eq 18, which
    without tilt is eq 14). Dots: the same with the reference's parameters, where it has them. Series that differ in a
    second key have a row of their own.
    """
    from matplotlib.figure import Figure

    fitted = [one for one in series if definition in one.profiles]
    key = _key(fitted)
    rows = list(dict.fromkeys(one.label_without(key) for one in fitted))
    labels = list(dict.fromkeys(_label(one, key) for one in fitted))
    with house():
        figure = Figure(figsize=(PAGE, (18 + 58 * len(rows)) * MILLIMETRE))
        axes = figure.subplots(len(rows), 3, squeeze=False, sharex="col")
        for one in fitted:
            row, style = rows.index(one.label_without(key)), look(labels.index(_label(one, key)))
            _draw(axes[row], one, definition, of_reference(comparisons, definition, one), style, _label(one, key))
        for ax_row, title in zip(axes, rows, strict=True):
            ax_row[0].set_title(title)
            for ax, text in zip(ax_row, ("$v_c$ [m/s]", r"$\phi_{max}$", "$W$ [g/s]"), strict=True):
                ax.set_ylabel(text)
            for ax in ax_row[[0, 2]]:
                from_zero(ax)
        for ax, text in zip(axes[-1], (r"$\sqrt{R}$ [mm$^{1/2}$]", "$R$ [mm]", "$R$ [mm]"), strict=True):
            ax.set_xlabel(text)
        handles = dict(zip(*reversed(_handles(axes)), strict=True))
        if any(of_reference(comparisons, definition, one).keys() & {"gamma", "epsilon1", "phi_inf"} for one in fitted):
            (dots,) = axes[0, 0].plot([], [], color=INK, linestyle=":")
            handles[source] = dots
        figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=min(len(handles), 6))
        figure.align_ylabels()
    return figure


def _key(series: Sequence[Series]) -> str:
    """The swept key that takes most values: colours tell it."""
    values = {name: {one.at.get(name) for one in series} for one in series for name in one.at}
    return max(values, key=lambda name: len(values[name]), default="")


def _label(series: Series, key: str) -> str:
    if key in series.at:
        return display.setting(key, series.at[key])
    return f"{display.key(key).name} not set" if key else "labbook"


def _handles(axes: np.ndarray) -> tuple[list, list[str]]:
    found = [ax.get_legend_handles_labels() for ax in axes[:, 0]]
    return [h for handles, _ in found for h in handles], [text for _, labels in found for text in labels]


def _draw(
    axes: Sequence["Axes"], series: Series, definition: str, theirs: "Mapping[str, float]", style: dict, label: str
) -> None:
    fit = series.profiles[definition]
    R = np.array([one.profile.R for one in fit.outlets])
    fine = np.linspace(0.9 * R.min(), 1.05 * R.max(), 120)
    scene = series.points[0].point.scene
    ours = {name: parameter.value for name, parameter in fit.parameters.items()}
    speeds, covers = ([getattr(one, name) for one in fit.outlets] for name in ("v_c", "phi_max"))
    flows = [result.flow_rate for result in series.profiled]
    for ax, x, numbers, scale in zip(
        axes, (np.sqrt(R * 1e3), R * 1e3, R * 1e3), (speeds, covers, flows), (1.0, 1.0, 1e3), strict=True
    ):
        shown = [(at, number) for at, number in zip(x, numbers, strict=True) if number is not None]
        _bars(ax, shown, scale, {**style, "linestyle": "none", "label": label})
    for parameters, line in ((ours, "-"), ({**_limit(theirs, ours), **theirs}, ":")):
        if parameters is not ours and not theirs:
            continue
        drawn = {"color": style["color"], "linestyle": line, "linewidth": 0.9, "zorder": 1}
        gamma = parameters.get("gamma", parameters.get("epsilon1", np.nan) ** 2)
        axes[0].plot(np.sqrt(fine * 1e3), middle_speed(gamma, fine, scene.gravity), **drawn)
        if parameters.keys() >= {"phi_inf", "tau1", "tau2"}:
            law = Saturation(parameters["phi_inf"], parameters["tau1"], parameters["tau2"])
            axes[1].plot(fine * 1e3, law.at(fine), **drawn)
        elif "phi_inf" in parameters and parameters is not ours:
            axes[1].axhline(parameters["phi_inf"], **drawn)
        flow = _flow(parameters, fine, scene.grains.diameter, scene.grains.density, scene.gravity)
        if flow is not None:
            axes[2].plot(fine * 1e3, 1e3 * flow, **drawn)


def _limit(theirs: "Mapping[str, float]", ours: "Mapping[str, float]") -> dict[str, float]:
    """Where a reference has tau1 and tau2 but not phi_inf, ours."""
    return {"phi_inf": ours["phi_inf"]} if "tau1" in theirs and "phi_inf" in ours else {}


def _bars(ax: "Axes", shown: Sequence[tuple[float, Pooled]], scale: float, style: dict) -> None:
    half = [number.half_width if np.isfinite(number.half_width) else 0.0 for _, number in shown]
    values = [number.value * scale for _, number in shown]
    ax.errorbar([at for at, _ in shown], values, yerr=np.array(half) * scale, markersize=3.5, **style)


def _flow(p: "Mapping[str, float]", R: np.ndarray, d: float, rho: float, g: float) -> np.ndarray | None:
    """W [kg/s] by eq 18 (centred profiles of a reference: by eq 14), with eq 12 where it is known, else phi_inf."""
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
