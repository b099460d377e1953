"""Section of the page on the stress on walls: balance of weight, forces of walls, profiles, and Janssen's law."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from labbook.fit import FitError
from labbook.fit.janssen import JanssenFit, ModelFit, preferred
from labbook.fit.result import NOT_DETERMINED
from labbook.measure.wall_stress import FILTER, FILTERS
from labbook.report.blocks import Block, Formula, Prose, Section, picture
from labbook.report.figures.vertical import vertical_stress
from labbook.report.figures.walls import wall_profiles
from labbook.report.tables import Table
from labbook.results.study import StudyResults
from labbook.results.walls import PooledWalls, VerticalStress, pooled_walls
from labbook.scene.quantities import percent

BALANCED = 1e-3
"""Deviation of the balance of weight at rest up to which a bed counts as at rest."""
HANGING = 0.25
"""Part of the weight from which on front and back walls decide the profile of the side walls."""
WHEN = {"rest": "at rest", "flow": "later"}
"""Words for the two states of a bed."""
_NUMBERS = (
    ("stress_ratio", "K", 1.0),
    ("wall_friction", "Mobilised friction of upright walls", 1.0),
    ("sliding_share", "Sliding contacts there", 100.0),
)
_SYMBOLS = {"length": "λ [mm]", "ratio": "K", "layer": "s or a [mm]"}
_SCALES = {"length": 1e3, "ratio": 1.0, "layer": 1e3}


def wall_sections(results: StudyResults, folder: Path) -> list[Section]:
    """Wall stress of each point that measured it."""
    points = [walls for walls in map(pooled_walls, results.points) if walls is not None]
    sections = []
    for number, walls in enumerate(points, 1):
        suffix = f"-{number}" if len(points) > 1 else ""
        sections.append(Section(walls.result.label or "Stress on walls", _blocks(walls, folder, suffix)))
    if len(sections) < 2:
        return [Section("Stress on walls", section.blocks) for section in sections]
    return [Section("Stress on walls", tuple(sections))]


def _blocks(walls: PooledWalls, folder: Path, suffix: str) -> tuple[Block, ...]:
    lacking = ""
    fits: Mapping[str, Mapping[str, JanssenFit]] = {}
    if walls.layout.at_rest:
        try:
            fits = walls.fits
        except FitError as problem:
            lacking = str(problem)
    figure = wall_profiles(walls, fits)
    profiles = picture(figure, folder / f"walls{suffix}", "stress on walls against height", _caption(fits))
    blocks: list[Block] = [Prose(balance(walls)), profiles, force_table(walls)]
    if peak := overshoot(walls):
        blocks.append(Prose(peak))
    if carried := front_and_back(walls):
        blocks.append(Prose(carried))
    if fits:
        blocks += [Section("Janssen’s law", (Formula(_FORMULA, _SOURCE), janssen_table(walls), Prose(choice(walls))))]
    if lacking:
        blocks.append(Prose(f"Not fitted: {lacking}.", note=True))
    if walls.vertical is not None:
        figure = vertical_stress(walls.vertical)
        alt = "vertical stress in the bed against height, from two sources"
        drawing = picture(figure, folder / f"vertical{suffix}", alt, _VERTICAL)
        blocks.append(Section("Vertical stress in the bed", (Prose(agreement(walls.vertical)), drawing)))
    return tuple(blocks)


def agreement(stress: VerticalStress) -> str:
    """Both sources of the vertical stress compared, and the screening lengths by the field, in words."""
    ratio, error = stress.ratio
    within = f" ± {error:.1g}" if math.isfinite(error) else ""
    text = (
        f"The mean vertical stress of the contacts in the bed is {ratio:.3f}{within} of that by weight and walls, "
        f"at {len(stress.z)} heights. The largest difference at one height is "
        f"{percent(stress.largest, '.2g')} of the mean."
    )
    if stress.fits:
        best = preferred(stress.fits)
        verdict = f"preferred: {best[0]}" if len(best) == 1 else f"undecided between {', '.join(best)}"
        lengths = ", ".join(f"{model} {_length(fit)}" for model, fit in stress.fits.items())
        text += f" λ by the contacts alone [mm]: {lengths}; {verdict}."
    return text


def _length(fit: ModelFit) -> str:
    length = fit.parameters["length"]
    return f"{1e3 * length.value:.3g} ({1e3 * length.low:.3g} to {1e3 * length.high:.3g})"


def balance(walls: PooledWalls) -> str:
    """The balance of weight, in words."""
    if not walls.layout.at_rest:
        return "The backend did not observe the bed at rest, so that there is no balance of weight before the opening."
    off = [run.rest_force[:, 2].sum() / run.weight - 1 for bed in walls.beds for run in bed]
    largest = max(off, key=abs)
    text = f"Balance of weight at rest: vertical forces of all walls are {1 + largest:.5f} M g"
    text += " (the bed that is farthest from 1)." if len(walls.beds) > 1 else "."
    if abs(largest) > BALANCED:
        text += f" That is off by more than {BALANCED:g}: the bed still moves; lower fill.settled_below."
    if flow := walls.result.pooled.get("weight_balance_flow"):
        error = f" ± {percent(flow.error, '.1g')}" if math.isfinite(flow.error) else ""
        outlet = walls.result.point.scene.container.outlet_plane
        momentum = "" if outlet is None else ", with the momentum of the outflow,"
        text += f" Later{momentum} they differ from M g by {percent(flow.value, '.2g')}{error}."
    return text


def force_table(walls: PooledWalls) -> Table:
    """Force, torque and application point of each wall, at rest and later."""
    layout = walls.layout
    weight = float(walls.by_bed("weight").mean())
    rows = []
    for when in ("rest", "flow"):
        (force, error), (torque, _), (point, _) = (
            walls.pooled(f"{when}_{name}") for name in ("force", "torque", "point")
        )
        local, _ = walls.pooled(when)
        for number, name in enumerate(layout.names.tolist()):
            if not np.isfinite(force[number]).all() or not force[number].any():
                continue
            share = f"{percent(force[number, 2] / weight, '.1f')}"
            if math.isfinite(error[number, 2]):
                share += f" ± {percent(error[number, 2] / weight, '.1f')}"
            normal, _, across = local[layout.wall == number].sum(axis=0)
            third = percent(across / normal, ".1f") if normal > 0 else "–"
            vectors = (third, _vector(force[number], 1.0), _vector(torque[number], 1e3), _vector(point[number], 1e3))
            rows.append((str(name), WHEN[when], share, *vectors))
    headings = ("wall", "when", "F_z/(M g)", "third/normal", "force [N]", "torque [mN m]", "application point [mm]")
    return Table(headings, tuple(rows), frozenset({0, 1, 4, 5, 6}), notes=(_FORCES,))


def overshoot(walls: PooledWalls) -> str:
    """Peak of the normal force on upright walls after the opening, in words; empty without an outlet."""
    peaks, _ = walls.pooled("peaks")
    _, opening = walls.opening()
    if walls.result.point.scene.container.outlet_plane is None or not np.isfinite(opening).any() or not opening.size:
        return ""
    every = ", ".join(f"{peak:.3g} ({tau:g})" for tau, peak in zip(FILTERS, peaks, strict=True) if math.isfinite(peak))
    largest, mean = peaks[FILTERS.index(FILTER)], opening.mean(axis=0).max()
    return (
        f"After the opening the normal force on upright walls has a peak of {largest:.3g} of that at rest (mean of the "
        f"peaks) or {mean:.3g} (peak of the mean). The force is a moving mean over {FILTER:g} √(d*/g). "
        f"Mean of the peaks for other times of the mean [√(d*/g)]: {every}."
    )


def front_and_back(walls: PooledWalls) -> str:
    """Reason why a side wall of a quasi-2D silo is no test of Janssen's law; empty of other silos."""
    layout, container = walls.layout, walls.result.point.scene.container
    faces = np.isin(layout.names, ["front", "back"])
    if container.symmetry != "planar" or not layout.at_rest or not faces.any():
        return ""
    share = float(walls.by_bed("rest_force")[:, faces, 2].sum(axis=1).mean() / layout.weight)
    friction = float(layout.friction[faces].max())
    if friction == 0:
        return "Front and back walls have no friction: the side walls and the bottom carry the bed."
    text = f"Front and back walls carry {percent(share, '.0f')} of the weight at rest."
    if share < HANGING:
        return f"{text} Side walls and bottom carry the rest."
    return (
        f"{text} With K = 0.5 and their friction fully mobilised the screening length is Z/(2 K μ) = "
        f"{container.front_to_back / friction * 1e3:.3g} mm: a profile of the side walls is no test of Janssen’s law."
    )


def janssen_table(walls: PooledWalls) -> Table:
    """Parameters of the models with intervals, and how well each fits."""
    rows = []
    for when, fits in walls.fits.items():
        best = min((fit.aicc for fit in fits.values()), default=math.nan)
        for model, fit in fits.items():
            cells = []
            for name, scale in _SCALES.items():
                parameter = fit.parameters.get(name)
                if parameter is None:
                    cells += ["–", "–"]
                    continue
                between = walls.error_between_beds(when, model, name)
                error = f" ± {scale * between:.2g}" if math.isfinite(between) else ""
                interval = f"{scale * parameter.low:.3g} to {scale * parameter.high:.3g}"
                determined = parameter.determined(about_zero=name == "layer")
                cells += [f"{scale * parameter.value:.3g}{error}", interval if determined else NOT_DETERMINED]
            rows.append((WHEN[when], model, *cells, f"{fit.friction:.3g}", f"{fit.aicc - best:.1f}"))
    parameters = [heading for symbol in _SYMBOLS.values() for heading in (symbol, "95 %")]
    notes = (_JANSSEN,) if len(walls.beds) >= 3 else (_JANSSEN, "With three beds or more, ± is added.")
    return Table(("when", "model", *parameters, "μ_m", "ΔAICc"), tuple(rows), frozenset({0, 1}), notes=notes)


def choice(walls: PooledWalls) -> str:
    """The preferred model, with K, mobilised friction and sliding contacts, in words."""
    numbers, text = walls.result.pooled, ""
    for when in walls.fits:
        models = walls.preferred(when)
        verdict = f"preferred: {models[0]}" if len(models) == 1 else f"undecided between {', '.join(models)}"
        text += f"{WHEN[when].capitalize()}, {verdict}. "
    for name, words, scale in _NUMBERS:
        for suffix, when in (("", "at rest"), ("_flow", "later")):
            number = numbers.get(f"{name}{suffix}")
            if number is None or not math.isfinite(number.value):
                continue
            error = f" ± {scale * number.error:.2g}" if math.isfinite(number.error) else ""
            text += f"{words} {when}: {scale * number.value:.3g}{error}{' %' if scale == 100 else ''}. "
    friction = walls.layout.friction[walls.layout.upright]
    return f"{text}Friction of the walls: {friction.max():g}."


def _vector(vector: np.ndarray, scale: float) -> str:
    return ", ".join(f"{scale * component:.3g}" if math.isfinite(component) else "–" for component in vector)


def _caption(fits: Mapping[str, Mapping[str, JanssenFit]]) -> str:
    lines = " Lines: Janssen’s models whose λ is determined; black: preferred." if fits else ""
    return f"{_CAPTION}{lines}"


_CAPTION = (
    "Compression is positive; the shear stress is that of the wall on the bed, positive upwards. Bars: standard "
    "errors between beds, of one bed later from blocks. Full: at rest, before the opening. Open: in the window of the "
    "flow rate, in closed containers in the second half of the run. After the opening: moving mean over 5 √(d*/g), of "
    "each bed and of all."
)
_FORCES = (
    "Forces are those of the wall on the bed; torques are about the origin. Third: component across the height of the "
    "wall, or across the radius or x, over the normal force; zero within errors. Application point: mean contact "
    "point, weighted by normal force."
)
_VERTICAL = (
    "Mean over the section. Full: coarse-grained stress of the contacts in the bed, width d*/2. Open: weight of the "
    "bed above, less the shear of upright walls there, over the section. Both: in the window of the flow rate, in "
    "closed containers in the second half of the run. Bars: standard errors between beds. Lines: Janssen’s models "
    "fitted to the contacts; black: preferred."
)
_FORMULA = "σ_zz = ρ_b g λ (1 - exp(-x/λ))"
_SOURCE = "J1: Janssen (1895); J2: with a shift s of the surface; J3: hydrostatic down to the depth a"
_JANSSEN = (
    "Fitted to normal and shear stress of upright walls, half a hydraulic diameter and more above their lower "
    "end and below the top layer. x: depth below the free surface of a level bed. μ_m = A/(P K λ). 95 %: from the "
    "scatter of bins; ±: between beds, by the jackknife."
)
