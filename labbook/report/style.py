"""House style of all figures: vector, colour-blind safe, readable in grey, and the same bytes on every run."""

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from labbook.lab.folder import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.markers import MarkerStyle
    from numpy import ndarray

INK, FAINT = "#1a1a1a", "#8a8a8a"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito 2008: distinguishable with any kind of colour vision."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 3)))

MILLIMETRE = 1 / 25.4
COLUMN, PAGE = 86 * MILLIMETRE, 178 * MILLIMETRE
"""Widths [inch] of one and of two columns of a journal page."""

FORMATS = ("png", "svg", "pdf")

_SETTINGS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # shipped with matplotlib: figures do not depend on the machine's fonts
    "font.size": 7.5,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.5,
    "legend.fontsize": 6.5,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.direction": "out",
    "ytick.direction": "out",
    "lines.linewidth": 1.1,
    "lines.markersize": 4,
    "errorbar.capsize": 2,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "figure.dpi": 150,
    "savefig.dpi": 300,
    "svg.fonttype": "none",  # text that can be selected, searched and edited
    "svg.hashsalt": "labbook",
    "pdf.fonttype": 42,
}

_METADATA = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


@contextmanager
def house() -> Iterator[None]:
    """Figures made inside have the house style, whatever the user's own matplotlib settings are."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_SETTINGS)
        yield


def encode(figure: "Figure", kind: str) -> bytes:
    """The figure as a file of `kind` (png, svg, pdf), without dates: equal figures are equal bytes."""
    buffer = BytesIO()
    with house():
        figure.savefig(buffer, format=kind, metadata=_METADATA[kind])
    return _in_fonts_of_journals(buffer.getvalue()) if kind == "svg" else buffer.getvalue()


def _in_fonts_of_journals(drawing: bytes) -> bytes:
    """The drawing with the fonts that journals ask for first. Text is laid out in a font that is as wide or wider."""
    return drawing.replace(b"'DejaVu Sans'", _FONTS)


_FONTS = b"Arial, Helvetica, 'Liberation Sans', 'DejaVu Sans', sans-serif"


def displayed(figure: "Figure") -> "Figure":
    """The figure, which a notebook then shows by itself, whether or not pyplot is in use there."""
    if not hasattr(figure, "_repr_png_"):
        figure._repr_png_ = partial(for_a_screen, figure)  # pyright: ignore[reportAttributeAccessIssue]
    return figure


def for_a_screen(figure: "Figure") -> tuple[bytes, dict[str, int]]:
    """The figure as PNG of twice the width [pixels] that a notebook is told to show it at."""
    buffer = BytesIO()
    with house():
        figure.savefig(buffer, format="png", dpi=2 * _SCREEN, metadata=_METADATA["png"])
    return buffer.getvalue(), {"width": round(figure.get_figwidth() * _SCREEN)}


_SCREEN = 110  # pixels an inch


def save(figure: "Figure", stem: Path) -> list[Path]:
    """Write `stem`.png, .svg and .pdf; the paths."""
    paths = []
    for kind in FORMATS:
        path = stem.with_name(f"{stem.name}.{kind}")
        write_bytes(path, encode(figure, kind), durable=False)
        paths.append(path)
        figure.set_layout_engine("none")  # laid out once: that takes as long as drawing
    return paths


def from_zero(ax: "Axes") -> None:
    """Let the vertical axis begin at zero, with room above: matplotlib's own margin is a part of the range of values,
    which may be less than half a marker."""
    ax.update_datalim([(0, 0)], updatex=False)
    ax.autoscale_view(scalex=False)
    ax.set_ylim(bottom=0)


def band(ax: "Axes", x: "ndarray", law: Sequence["ndarray"], point: Sequence["ndarray"], colour: str) -> None:
    """Shade the interval of a law between its two ends and, fainter, that of one more point."""
    for (low, high), alpha in ((point, 0.09), (law, 0.2)):
        ax.fill_between(x, low, high, color=colour, alpha=alpha, linewidth=0, zorder=0)


def point(
    ax: "Axes", x: float, value: float, ends: tuple[float, float], *, color: str, hollow: bool = False, **look: Any
) -> None:
    """A marker at `value` with its interval from `ends[0]` to `ends[1]`: hollow, with a dashed bar without ends, where
    the interval is not known. `look`: marker, its size, zorder."""
    finite = all(map(math.isfinite, ends))
    face = "white" if hollow or not finite else color
    options = {"color": color, "linestyle": "none", "markerfacecolor": face, **look}
    if finite:
        ax.errorbar(x, value, yerr=[[max(value - ends[0], 0.0)], [max(ends[1] - value, 0.0)]], **options)
        return
    bar = {"marker": _open_bar(), "markersize": _OPEN, "markeredgewidth": 0.8, "label": OPEN_BAR}
    ax.plot(x, value, color=color, linestyle="none", zorder=options.get("zorder", 2), clip_on=False, **bar)
    ax.errorbar(x, value, yerr=0.0, capsize=0, **options)


def legend_point(ax: "Axes", label: str, **look: Any) -> None:
    """An entry of the legend for points of one look, filled: whatever the first of them has to say of itself."""
    ax.plot([], [], linestyle="none", label=label, **look)


def crosses(ax: "Axes", positions: Sequence[tuple[float, str]], color: str) -> None:
    """A cross at the foot of the panel for each x without a value, and above it why, if there is anything to say."""
    from matplotlib.patheffects import withStroke

    foot = ax.get_xaxis_transform()
    for x, why in positions:
        ax.plot(x, _FOOT, marker="x", color=color, linestyle="none", transform=foot, clip_on=False, zorder=3)
        if why:
            beside = {"rotation": 90, "ha": "center", "va": "bottom", "size": 5.5, "color": color}
            beside["path_effects"] = [withStroke(linewidth=1.5, foreground="white")]  # curves may pass here
            ax.annotate(verbatim(why), (x, _FOOT), (0, 5), xycoords=foot, textcoords="offset points", **beside)


_FOOT = 0.03  # height of crosses in a panel
_OPEN = 28  # length of a bar without ends [points]
OPEN_BAR = "_open"
"""Label of bars without ends, which no legend lists."""


def has_open_bars(figure: "Figure") -> bool:
    """True if the interval of any point is unknown."""
    return any(line.get_label() == OPEN_BAR for ax in figure.axes for line in ax.lines)


@cache
def _open_bar() -> "MarkerStyle":
    """A dashed vertical line as a marker: its length is the same on every scale, and sets no limits of axes."""
    from matplotlib.markers import MarkerStyle
    from matplotlib.path import Path as Outline

    dashes = 7
    ends = [-1 + 2 * (k + part) / (dashes - 0.5) for k in range(dashes) for part in (0.0, 0.5)]
    return MarkerStyle(Outline([(0, end) for end in ends], [Outline.MOVETO, Outline.LINETO] * dashes), fillstyle="none")


def beside_title(title: str) -> Literal["outside upper right", "outside lower center"]:
    """Place of the legend of a page-wide figure: in the line of its title; below the axes if the title is long."""
    return "outside upper right" if len(title) <= _SHORT else "outside lower center"


def legend_columns(labels: Sequence[str], width: float = PAGE) -> int:
    """Columns of a legend that fit into a figure of this width [inch], four at most."""
    across = int(_LINE * width / PAGE)
    return max(1, min(len(labels), 4, across // (max(map(len, labels), default=1) + _HANDLE)))


_SHORT, _LINE, _HANDLE = 44, 130, 8
"""Characters: of a title that leaves room for a legend, of a line of legends across a page, and of the line of an entry
with the space around it."""


def verbatim(text: str) -> str:
    """`text` of a study's author as matplotlib shows it: dollars are dollars, and begin no formula."""
    return text.replace("$", r"\$")


def mathtext(text: str) -> str:
    """Matplotlib's spelling of a label with superscripts written ^(...), and subscripts of single letters: `φ_d`."""
    text = re.sub(r"\b(\w)_(\w+|∞)", r"$\1_{\2}$", text)
    return re.sub(r"\^\(([^)]*)\)", r"$^{\1}$", text)


def look(index: int) -> dict:
    """Colour, marker and dash of the series numbered `index`; the combination repeats only after 49 of them."""
    turn = index // len(COLOURS)
    return {
        "color": COLOURS[index % len(COLOURS)],
        "marker": MARKERS[(index + turn) % len(MARKERS)],
        "linestyle": DASHES[(index + turn) % len(DASHES)],
    }
