"""Fitted parameters against the start of the window."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from labbook.report.style import INK, MILLIMETRE, PAGE, house, legend_columns, look, mathtext
from labbook.results import display
from labbook.results.reference import Comparison, of_reference
from labbook.results.series import Series
from labbook.results.starts import AtStart, parameters_at

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def parameters_against_start(
    starts: Sequence[AtStart],
    series: Sequence[Series],
    law: str,
    names: Sequence[str],
    comparisons: Sequence[Comparison] = (),
) -> "Figure":
    """Draw the parameters `names` of `law`, a panel each, against the discharged fraction at which windows open.

    Bars: one standard error. Hollow: the end of the start-up, at the mean over runs; ring: the stated window. Dotted:
    the reference.
    """
    from matplotlib.figure import Figure

    fitted = [member for member in series if member.parameters(law)]
    with house():
        figure = Figure(figsize=(PAGE, 58 * MILLIMETRE))
        axes = figure.subplots(1, len(names), squeeze=False)[0]
        for ax, name in zip(axes, names, strict=True):
            symbol = display.quantity(f"{law}.{name}")
            for index, member in enumerate(fitted):
                style = look(index)
                bare = {"linestyle": "none", "markerfacecolor": "none"}
                line = []
                for at, parameter in parameters_at(starts, member, law, name):
                    abscissa = at.opens if at.window.auto else at.window.start
                    value, error = parameter.value * symbol.scale, parameter.error * symbol.scale
                    if at.window.auto:
                        ax.errorbar(abscissa, value, yerr=error, **{**style, **bare, "markersize": 4})
                    else:
                        line.append((abscissa, value, error))
                    if at.of_study:
                        ax.plot(abscissa, value, marker="o", markersize=8, color=style["color"], **bare)
                if line:
                    x, y, bars = zip(*line, strict=True)
                    ax.errorbar(x, y, yerr=bars, markersize=3, label=member.label, **style)
                if (reference := of_reference(comparisons, law, member).get(name)) is not None:
                    color = style["color"] if len(fitted) > 1 else INK
                    ax.axhline(reference * symbol.scale, color=color, linestyle=":", linewidth=0.8, zorder=0)
            ax.set_xlabel("discharged when the window opens")
            ax.set_ylabel(mathtext(symbol.heading))
        labels = [member.label for member in fitted if member.label]
        if labels:
            entries = axes[0].get_legend_handles_labels()
            figure.legend(*entries, loc="outside lower center", ncols=legend_columns(labels))
    return figure
