"""Sections on outlets: their profiles, the laws fitted to them, and flow rates over a plain hopper's."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from labbook.measure.outlet import CROSSINGS, DEFINITIONS
from labbook.papers.fan2023 import figures
from labbook.papers.fan2023.profiles import ProfileFit, approaches, profile_fit, shared_parameters
from labbook.papers.fan2023.ratios import RATIOS, Ratio, angle_factors, authors, by_angle, by_position
from labbook.report.blocks import Block, Folded, Formula, Picture, Section, picture
from labbook.report.fitted_tables import parameter_table
from labbook.report.starts import NOTE, start_label
from labbook.report.tables import INSIDE, Table
from labbook.results import display
from labbook.results.reference import Comparison, at_series, of_reference
from labbook.results.series import Series
from labbook.results.starts import AtStart, at_starts
from labbook.results.study import StudyResults
from labbook.scene.quantities import percent


def profile_section(
    results: StudyResults, series: Series, definition: str, folder: Path, suffix: str, where: str
) -> Section:
    """Section on a series: profiles along its outlets and their middles, with the fitted laws."""
    name = definition.removeprefix("outlet_")
    along = figures.outlet_profiles(series, definition, results.comparisons, results.source)
    middles = figures.outlet_middles(series, definition, results.comparisons, results.source)
    return Section(
        f"Profiles along the outlets: {DEFINITIONS[definition]}",
        (
            Formula(ProfileFit.formula, ProfileFit.source),
            picture(along, folder / f"{name}{suffix}", f"{name} along the outlets{where}", ALONG),
            profile_table(series, definition, results.comparisons, results.source),
            picture(middles, folder / f"{name}-middles{suffix}", f"middles of the {name}{where}", MIDDLES),
            outlet_table(series, definition),
        ),
    )


def tables_of(results: StudyResults, series: Series, definition: str, where: str) -> list[tuple[str, Table]]:
    """Titles and tables of the fits to the profiles of a series, for the terminal."""
    title = f"Profiles along the outlets{where} ({DEFINITIONS[definition]}): {ProfileFit.formula}"
    fitted = profile_table(series, definition, results.comparisons, results.source)
    return [(title, fitted), (f"Outlets{where}", outlet_table(series, definition))]


def outlet_pictures(results: StudyResults, folder: Path) -> list[Picture]:
    """Pictures of middles of profiles and flow rates of all series, by each fitted definition of the profiles."""
    pictures = []
    for definition in DEFINITIONS:
        if sum(definition in series.further for series in results.series) > 1:
            figure = figures.outlets_of_all(results.series, definition, results.comparisons, results.source)
            name = definition.removeprefix("outlet_")
            alt = f"middles of the {name} of all series"
            pictures.append(picture(figure, folder / f"{name}-all", alt, f"{_sentence(definition)} {_OUTLETS}"))
    return pictures


def ratio_sections(results: StudyResults, folder: Path) -> list[Section]:
    """Sections on flow rates over a plain hopper's, if the angle of the bottom or the place of the outlet varies."""
    sections = []
    if angles := by_angle(results.points):
        figure = figures.flow_against_angle(angles)
        caption = f"{_ANGLES} {farthest(angles)}"
        angle_picture = picture(figure, folder / "ratio-angle", "flow rate against angle over that of 90 deg", caption)
        sections.append(
            Section("Beside a plain hopper", (angle_picture, Folded("The numbers", (angle_table(angles),))))
        )
    if positions := by_position(results.points):
        figure = figures.flow_against_position(positions, results.comparisons, results.source)
        alt = "flow rate against position over that in the middle"
        blocks: list[Block] = [picture(figure, folder / "ratio-position", alt, _POSITIONS)]
        fitted = (name for name in DEFINITIONS if any(name in series.further for series in results.series))
        for name in fitted:
            label = name.removeprefix("outlet_")
            figure = figures.shape_against_position(positions, name, results.comparisons, results.source)
            alt = f"shape of the {label} against position"
            caption = f"{_sentence(name)} {_SHAPES}"
            blocks.append(picture(figure, folder / f"{label}-position", alt, caption))
            if fitted_to := approach_table(positions, name, results.comparisons, results.source):
                blocks.append(fitted_to)
        blocks.append(Folded("The numbers", (position_table(positions),)))
        sections.append(Section("Beside a plain hopper", tuple(blocks)))
    return sections


def start_sections(results: StudyResults) -> list[Section]:
    """Sections on profiles and flow rates over a plain hopper's, against the start of the window."""
    starts, blocks = at_starts(results), list[Block]()
    if not starts:
        return []
    for definition in (name for name in DEFINITIONS if any(name in series.further for series in results.series)):
        table = _shape_against_start(results, starts, definition)
        blocks.append(Folded(f"Profiles ({DEFINITIONS[definition]})", (table,)))
    for name, ratios in RATIOS.items():
        by_start = [{ratio.result.label: ratio for ratio in ratios(at.points)} for at in starts]
        labels = dict.fromkeys(label for by_label in by_start for label, ratio in by_label.items() if ratio.error > 0)
        rows = [(label, *(_numbers(by_label[label])[0] if label in by_label else "–" for by_label in by_start))
                for label in labels]  # fmt: skip
        if rows:
            table = Table(("point", *(at.label for at in starts)), tuple(rows), notes=(NOTE,))
            blocks.append(
                Folded(f"W/W {'of the flat bottom' if name.endswith('angle') else 'in the middle'}", (table,))
            )
    return [Section("Profiles and ratios against the start of the window", tuple(blocks))] if blocks else []


def _shape_against_start(results: StudyResults, starts: Sequence[AtStart], definition: str) -> Table:
    """Tabulate a, gamma and b of each series and start, with those of the reference."""
    symbols = {name: display.quantity(f"{definition}.{name}") for name in ("a", "gamma", "b")}
    rows: list[tuple[str, ...]] = []
    for series in (series for series in results.series if definition in series.further):
        values = {start_label(at, series): shared_parameters(definition, moved.points)
                  for at in starts if (moved := at.of(series)) is not None}  # fmt: skip
        if reference := of_reference(results.comparisons, definition, series):
            values[results.source] = reference
        for label, parameters in values.items():
            cells = (f"{parameters[name]:.3f}" if name in parameters else "–" for name in symbols)
            rows.append((series.label, label, *cells))
    headings = ("series", "start", *(symbol.heading for symbol in symbols.values()))
    return Table(headings, tuple(rows), frozenset({0, 1}), notes=(NOTE,))


def farthest(ratios: list[Ratio]) -> str:
    """State the largest distance of the flow rates from each angle law, inside or outside the 95 % interval."""
    inclined = [ratio for ratio in ratios if ratio.error > 0]
    if not inclined:
        return ""
    sentences = []
    for name in authors(inclined):
        compared = [(ratio, laws[name]) for ratio in inclined if name in (laws := angle_factors(ratio))]
        worst, factor = max(compared, key=lambda pair: abs(pair[0].value / pair[1] - 1))
        deviation, side = percent(worst.value / factor - 1, "+.1f"), "inside" if worst.holds(factor) else "outside"
        sentences.append(f"{name} by {deviation} ({side} the 95 % interval, {worst.runs}) at {worst.result.label}")
    return f"Farthest from {'; from '.join(sentences)}.".replace("-", "−")


def angle_table(ratios: list[Ratio]) -> Table:
    """Tabulate every ratio with its interval, and its distance from each angle law."""
    names, rows = authors(ratios), []
    for ratio in ratios:
        laws = angle_factors(ratio)
        cells = [cell for name in names for cell in _apart(ratio, laws.get(name))]
        rows.append((ratio.result.label, *_numbers(ratio), *cells))
    headings = [heading for name in names for heading in (name, "difference", INSIDE)]
    return Table(("point", "W/W of the flat bottom", "95 % interval", *headings), tuple(rows))


def position_table(ratios: list[Ratio]) -> Table:
    """Tabulate every ratio with its interval against s*."""
    ordered = sorted(ratios, key=lambda ratio: (ratio.result.orifice, ratio.at))
    rows = tuple((ratio.result.label, f"{ratio.at:.3g}", *_numbers(ratio)) for ratio in ordered)
    return Table(("point", "s*", "W/W in the middle", "95 % interval"), rows)


def _sentence(definition: str) -> str:
    """Describe a definition of profiles in a sentence."""
    words = DEFINITIONS[definition]
    return f"{words[:1].upper()}{words[1:]}."


def _numbers(ratio: Ratio) -> tuple[str, str]:
    if not ratio.error > 0:
        return display.number(ratio.value), "–"
    return (
        display.with_error(ratio.value, ratio.error),
        f"{display.number(ratio.low, ratio.error)} to {display.number(ratio.high, ratio.error)}",
    )


def _apart(ratio: Ratio, law: float | None) -> tuple[str, str, str]:
    if law is None:
        return "–", "–", "–"
    if not (ratio.error > 0 and np.isfinite(ratio.error)):
        return f"{law:.3f}", "–", "–"
    apart = ratio.value - law
    return f"{law:.3f}", percent(apart / law, "+.1f").replace("-", "−"), "yes" if ratio.holds(law) else "no"


_ANGLES = (
    "Flow rate over that of a flat bottom with the same outlet, with 95 % intervals. Lines have no free parameter; "
    "φ_d of Rose and Tanaka is the angle of the stagnant zone. It is not measured here; the arctangent of the grains’ "
    "friction is assumed for it."
)
_POSITIONS = (
    "Flow rate over that of the same outlet in the middle against the relative distance from the wall, with 95 % "
    "intervals; diamonds: the reference."
)
_SHAPES = (
    "Shape of the profiles of each point (eqs 16 and 17) against the relative distance from the wall; bars: one "
    "standard error over seeds. Lines: limit − depth exp(−rate s*), with 95 % bands, of the law and, "
    "fainter, of one more point, fitted to all points of a panel alike, with standard errors from their scatter; dots: "
    "the reference."
)
_OUTLETS = (
    "Left: velocity in the middle, and sqrt(2 g γ R). Middle: largest area fraction, and eq 12. Right: flow rate "
    "counted, and that of the profiles by eq 18. Bars: 95 % intervals; dots: the same laws with the parameters of the "
    "reference, its φ_∞ being ours where it has only τ₁ and τ₂."
)


def profile_table(series: Series, definition: str, comparisons: Sequence[Comparison] = (), source: str = "") -> Table:
    """Tabulate the parameters of the profiles along the outlets of a series, beside the reference."""
    fit = profile_fit(series, definition)
    collapse = f"Root mean square about the domes: {fit.misfit[0]:.2g} of v_c, {fit.misfit[1]:.2g} of φ_c."
    notes = (collapse, *(f"{note[:1].upper()}{note[1:]}." for note in fit.notes))
    return parameter_table(definition, fit.parameters, at_series(comparisons, definition, series), source, notes)


def approach_table(
    ratios: Sequence[Ratio], definition: str, comparisons: Sequence[Comparison] = (), source: str = ""
) -> Table | None:
    """Tabulate limit, depth and rate of tilts and exponents against s*; None with too few places."""
    fitted = {
        name: approached.approach
        for name, approached in approaches(ratios, definition).items()
        if approached.approach is not None
    }
    parameters = {f"{name}.{term}": p for name, law in fitted.items() for term, p in law.parameters.items()}
    theirs = {c.quantity.partition(".")[2]: c for c in comparisons if c.quantity.startswith(f"{definition}.")}
    return parameter_table(definition, parameters, theirs, source) if parameters else None


_OF_OUTLET = {
    "v_c": "v_c [m/s]",
    "phi_c": "φ_c",
    "direct": "∫/W",
    "centred": "eq 14/W",
    "printed": "printed/W",
    "eccentric": "eq 18/W",
}


def outlet_table(series: Series, definition: str) -> Table:
    """Tabulate each outlet of a series: middle of its profiles, and the flow rate from them over the counted one."""
    fit = profile_fit(series, definition)
    whole = definition == CROSSINGS  # the integral of crossings is the counted flow rate by definition
    columns = {name: heading for name, heading in _OF_OUTLET.items() if not (whole and name == "direct")}
    rows = tuple(
        (
            f"{result.orifice * 1e3:g}",
            *(display.with_error(getattr(outlet, name).value, getattr(outlet, name).error) for name in columns),
        )
        for result, outlet in zip(fit.points, fit.outlets, strict=True)
    )
    measured = "" if whole else "by integrating them as measured; "
    notes = (
        f"Flow of the profiles over the flow counted, W: {measured}by eq 14 with v_c and φ_c of each outlet; by eq 14 "
        "as printed, with γ and φ_∞ (φ_c where φ_∞ could not be fitted); by eq 18.",
    )
    return Table(("D [mm]", *columns.values()), rows, frozenset(), notes=notes)


ALONG = (
    "Velocity (left) and area fraction (right) along the outlets: as measured, and divided by their values in the "
    "middle. Points are fitted; bins without points are not. Bands about points: one standard error over seeds; about "
    "the law: 95 %, of the law and, fainter, of a bin of one more outlet. Dashed: the tilted curves of eqs 16 and 17, "
    "where the tilt is significant; the bands are then theirs."
)
MIDDLES = (
    "Velocity and area fraction in the middle of the outlets, and the flow that the profiles come to, over the flow "
    "counted. Bars: one standard error over seeds; bands: 95 %, of the law and, fainter, of one more outlet; dots: the "
    "law with the parameters of the reference, its φ_∞ being ours where it has only τ₁ and τ₂."
)
