"""The pilot of a study: a few settings of its numerics at its first and last point, to see what they do to W."""

from collections.abc import Mapping
from typing import Any

from labbook.scene.timescales import largest_stable_step
from labbook.study.load import Study, define
from labbook.study.point import Point

SEEDS = 8
SETTINGS = ((1.0, 0.33, 1.0), (1.0, 0.75, 1.0), (0.3, 0.75, 1.0), (0.1, 0.75, 1.0), (0.03, 0.75, 1.0), (0.1, 0.75, 0.1),
            (0.03, 0.75, 0.03))  # fmt: skip
"""Stiffness scale, step in parts of the largest stable one, and stiffness scale of the filling."""
_KEPT = ("grains", "contact", "container", "walls", "gravity", "window", "stop")


def is_pilot(study: Study) -> bool:
    """Whether a study itself sweeps numerics, so that it needs no pilot."""
    return any(key.startswith("numerics.") for point in study.points for key in point.at)


def pilot(study: Study, seeds: int = SEEDS) -> Study:
    """The pilot of `study`: SETTINGS at its first and last point, `seeds` runs each; beds are shared by all settings
    that fill them alike. Raises StudyError."""
    ends = [study.points[place] for place in sorted({0, len(study.points) - 1})]
    points = [{**_at(study, point), **numerics} for numerics in _numerics(ends) for point in ends]
    stated = {key: study.stated[key] for key in _KEPT if key in study.stated}
    fill = {key: value for key, value in study.stated.get("fill", {}).items() if key != "numerics"}
    return define(
        {
            **stated,
            "name": f"{study.name[:70]}-pilot",
            "about": f"What time step and stiffness do to the flow rate of {study.name}",
            "fill": fill,
            "points": points,
            "replicates": seeds,
            "measure": ["flow_rate"],
        }
    )


def _at(study: Study, point: Point) -> Mapping[str, Any]:
    """What is swept at a point, as a study file has it."""
    kept = {key: value for key, value in point.at.items() if not key.startswith(("numerics.", "fill.numerics."))}
    return {key: v if isinstance(v, str) else f"{v!r} {study.units.get(key, '')}".strip() for key, v in kept.items()}


def _numerics(points: list[Point]) -> list[Mapping[str, str]]:
    """The settings, with one step for all points, so that they can share beds."""
    found = []
    for scale, part, filled in SETTINGS:
        flow, bed = (min(_stable(point, s) for point in points) for s in (scale, filled))
        found.append(
            {
                "numerics.stiffness_scale": f"{scale:g}",
                "numerics.dt": f"{part * flow:.6g} s",
                "fill.numerics.stiffness_scale": f"{filled:g}",
                "fill.numerics.dt": f"{0.66 * bed:.6g} s",
            }
        )
    return found


def _stable(point: Point, scale: float) -> float:
    """The largest stable step [s] of a point's flow and filling."""
    scenes = (point.scene, point.scene.close(point.fill.friction, point.fill.contact))
    return min(largest_stable_step(scene.stiffened(scale)) for scene in scenes)
