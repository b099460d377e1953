"""The pilot of a study: a few settings of its numerics at three of its points, to see what they do to W.

Three points, the first, the one in the middle and the last, since fewer tell nothing of the points between them
(`labbook.stats.effects.FEWEST`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

from labbook.accuracy import groups
from labbook.campaign import Assignment, History, Proposal, Strategy
from labbook.scene.timescales import largest_stable_step
from labbook.study.load import Study, define
from labbook.study.point import Point
from labbook.study.proposed import written_at

SEEDS = 8
SETTINGS = ((1.0, 0.33, 1.0), (1.0, 0.75, 1.0), (0.3, 0.75, 1.0), (0.1, 0.75, 1.0), (0.03, 0.75, 1.0), (0.1, 0.75, 0.1),
            (0.03, 0.75, 0.03))  # fmt: skip
"""Stiffness scale, step in parts of the largest stable one, and stiffness scale of the filling."""
STEPS, STEPS_SEEDS = SETTINGS[:2], 16
"""Settings and seeds of the pilot that precedes a study whose numerics are to be chosen. It varies the step alone: the
bias of soft grains is rarely small enough for softness to save time (docs/accuracy.md)."""


class Pilot(Strategy):
    """Runs all settings of a pilot at once, after which numerics can be chosen for the requested error."""

    name: ClassVar[str] = "pilot"

    def propose(self, history: History) -> Proposal:
        """Propose all points of the pilot, and then nothing more."""
        if history.number:
            return Proposal.end("all settings are proposed")
        points, seeds = history.study.points, history.study.replicates
        reason = f"no scene like these was measured: {len(points)} settings of numerics with {seeds} seeds each"
        return Proposal(tuple(Assignment(point.at, seeds) for point in points), reason)


_SHARED = ("grains", "contact", "container", "walls", "gravity", "window", "stop")


def is_pilot(study: Study) -> bool:
    """True if a study sweeps numerics itself, so that it needs no pilot."""
    return any(key.startswith("numerics.") for point in study.points for key in point.at)


def pilot(study: Study, seeds: int = SEEDS) -> Study:
    """The pilot of `study`: SETTINGS at its first, middle and last point, `seeds` runs each; beds are shared by all
    settings that fill them alike. Raises StudyError."""
    return _pilot(study, _spread(study.points), seeds, SETTINGS)


def whole(study: Study, seeds: int = SEEDS) -> Study:
    """The pilot of `study`, or the study itself where it sweeps numerics and so is its own pilot. Raises StudyError."""
    return study if is_pilot(study) else pilot(study, seeds)


def first_needed(study: Study) -> Study | None:
    """The pilot that is needed before the numerics of `study` can be chosen for the requested error: STEPS at
    the first, middle and last of its points of each kind where too little was measured. None if there are none.
    Raises StudyError."""
    kinds: dict[tuple[str, ...], list[Point]] = {}
    for point in study.points:
        if point.wants_pilot and (here := groups(point.scene, 1.0, 1.0)) is not None:
            kinds.setdefault((here.shape, here.outlet, here.law), []).append(point)
    pilot_points = [point for points in kinds.values() for point in _spread(points)]
    return _pilot(study, pilot_points, STEPS_SEEDS, STEPS) if pilot_points else None


def _spread(points: Sequence[Point]) -> list[Point]:
    """The first, the middle and the last of several points; all of three or fewer."""
    return [points[index] for index in sorted({0, len(points) // 2, len(points) - 1})]


def _pilot(
    study: Study, pilot_points: list[Point], seeds: int, settings: Sequence[tuple[float, float, float]]
) -> Study:
    points = [{**_at(point), **numerics} for numerics in _numerics(pilot_points, settings) for point in pilot_points]
    sections = {key: study.definition[key] for key in _SHARED if key in study.definition}
    if not (study.window.timed or study.fed):  # with its points alone the window could be another one
        sections["window"] = {"start": study.window.opening, "end": study.window.end}
    fill = {key: value for key, value in study.definition.get("fill", {}).items() if key != "numerics"}
    defined = define(
        {
            **sections,
            "name": f"{study.name[:70]}-pilot",
            "about": f"What time step and stiffness do to the flow rate of {study.name}",
            "fill": fill,
            "points": points,
            "replicates": seeds,
            "measure": ["flow_rate"],
        }
    )
    return replace(defined, adapt=Pilot())


def _at(point: Point) -> Mapping[str, Any]:
    """Swept values of a point other than numerics, as a study file has them."""
    swept = {key: value for key, value in point.at.items() if not key.startswith(("numerics.", "fill.numerics."))}
    return written_at(swept)


def _numerics(points: list[Point], settings: Sequence[tuple[float, float, float]]) -> list[Mapping[str, str]]:
    """The settings, with one step for all points, so that they can share beds."""
    numerics = []
    for scale, relative, filled in settings:
        flow, bed = (min(_stable(point, s) for point in points) for s in (scale, filled))
        numerics.append(
            {
                "numerics.stiffness_scale": f"{scale:g}",
                "numerics.dt": f"{relative * flow * 1e6:.6g} us",
                "fill.numerics.stiffness_scale": f"{filled:g}",
                "fill.numerics.dt": f"{0.66 * bed * 1e6:.6g} us",
            }
        )
    return numerics


def _stable(point: Point, scale: float) -> float:
    """The largest stable step [s] of a point's flow and filling."""
    scenes = (point.scene, point.scene.close(point.fill.friction, point.fill.contact))
    return min(largest_stable_step(scene.stiffened(scale)) for scene in scenes)
