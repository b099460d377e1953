"""What the page shows of all series together beside their parameters: outlets, and flow rates over a plain hopper's."""

from pathlib import Path

import numpy as np

from labbook.fit.outlet import DEFINITIONS
from labbook.report import figures
from labbook.report.blocks import Block, Folded, Picture, Section, picture
from labbook.report.outlet_tables import approach_table
from labbook.report.tables import Table
from labbook.results import display
from labbook.results.ratios import Ratio, angle_laws, by_angle, by_position
from labbook.results.study import Results


def outlet_pictures(results: Results, folder: Path) -> list[Picture]:
    """Middles of profiles and flow rates of all series, by each definition of the profiles that was fitted."""
    pictures = []
    for definition in DEFINITIONS:
        if sum(definition in one.profiles for one in results.series) > 1:
            figure = figures.outlets_of_all(results.series, definition, results.comparisons, results.source)
            name = definition.removeprefix("outlet_")
            alt = f"middles of the {name} of all series"
            pictures.append(picture(figure, folder / f"{name}-all", alt, f"{_sentence(definition)} {_OUTLETS}"))
    return pictures


def ratio_sections(results: Results, folder: Path) -> list[Section]:
    """Flow rates over that of a plain hopper, where the angle of its bottom or the place of its outlet was varied."""
    sections = []
    if angles := by_angle(results.points):
        figure = figures.flow_against_angle(angles)
        caption = f"{_ANGLES} {farthest(angles)}"
        drawn = picture(figure, folder / "ratio-angle", "flow rate against angle over that of 90 deg", caption)
        sections.append(Section("Beside a plain hopper", (drawn, Folded("The numbers", (angle_table(angles),)))))
    if positions := by_position(results.points):
        figure = figures.flow_against_position(positions, results.comparisons, results.source)
        alt = "flow rate against position over that in the middle"
        blocks: list[Block] = [picture(figure, folder / "ratio-position", alt, _POSITIONS)]
        fitted = (name for name in DEFINITIONS if any(name in one.profiles for one in results.series))
        for name in fitted:
            called = name.removeprefix("outlet_")
            figure = figures.shape_against_position(positions, name, results.comparisons, results.source)
            alt = f"shape of the {called} against position"
            caption = f"{_sentence(name)} {_SHAPES}"
            blocks.append(picture(figure, folder / f"{called}-position", alt, caption))
            if fitted_to := approach_table(positions, name, results.comparisons, results.source):
                blocks.append(fitted_to)
        blocks.append(Folded("The numbers", (position_table(positions),)))
        sections.append(Section("Beside a plain hopper", tuple(blocks)))
    return sections


def farthest(ratios: list[Ratio]) -> str:
    """A sentence on how far the flow rates lie from each angle law at most, and in how many standard errors."""
    inclined = [one for one in ratios if one.error > 0]
    if not inclined:
        return ""
    said = []
    for law in angle_laws(inclined[0].result):
        worst = max(inclined, key=lambda one: abs(one.value / law.factor(one.at) - 1))
        apart = worst.value - law.factor(worst.at)
        percent, errors = 100 * apart / law.factor(worst.at), apart / worst.error
        said.append(
            f"{law.name.partition(',')[0]} by {percent:+.1f} % or {errors:+.1f} standard errors at {worst.result.label}"
        )
    return f"Farthest from {'; from '.join(said)}.".replace("-", "−")


def angle_table(ratios: list[Ratio]) -> Table:
    """Every ratio with its interval, and how far it lies from each angle law."""
    laws = angle_laws(ratios[0].result)
    rows = []
    for one in ratios:
        cells = [cell for law in laws for cell in _apart(one, law.factor(one.at))]
        rows.append((one.result.label, *_numbers(one), *cells))
    named = [heading for law in laws for heading in (law.name.partition(",")[0], "difference", "in standard errors")]
    return Table(("point", "W/W of the flat bottom", "95 % interval", *named), tuple(rows))


def position_table(ratios: list[Ratio]) -> Table:
    """Every ratio with its interval against s*."""
    ordered = sorted(ratios, key=lambda one: (one.result.orifice, one.at))
    rows = tuple((one.result.label, f"{one.at:.3g}", *_numbers(one)) for one in ordered)
    return Table(("point", "s*", "W/W in the middle", "95 % interval"), rows)


def _sentence(definition: str) -> str:
    """What profiles are by a definition."""
    words = DEFINITIONS[definition]
    return f"{words[:1].upper()}{words[1:]}."


def _numbers(one: Ratio) -> tuple[str, str]:
    if not one.error > 0:
        return display.number(one.value), "–"
    return (
        display.with_error(one.value, one.error),
        f"{display.number(one.low, one.error)} to {display.number(one.high, one.error)}",
    )


def _apart(one: Ratio, law: float) -> tuple[str, str, str]:
    if not (one.error > 0 and np.isfinite(one.error)):
        return f"{law:.3f}", "–", "–"
    apart = one.value - law
    percent, errors = f"{100 * apart / law:+.1f} %", f"{apart / one.error:+.1f}"
    return f"{law:.3f}", percent.replace("-", "−"), errors.replace("-", "−")


_ANGLES = (
    "Flow rate over that of a flat bottom with the same outlet, with 95 % intervals. Lines have no free parameter; "
    "the angle φ_d of Rose and Tanaka, which papers seldom give, is the arctangent of the grains’ friction."
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
