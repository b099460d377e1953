"""Flow rates relative to that of a plain hopper: a flat bottom, an outlet in the middle."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from labbook.papers.fan2023.laws import brown, rose_tanaka
from labbook.results.points import PointResult
from labbook.scene import WedgeHopper
from labbook.stats.ratio import independent_ratio

ANGLE, GAP = "container.angle", "container.gap"


@dataclass(frozen=True)
class Ratio:
    """W of a point (`result`) over that of the plain hopper (`over`) that is like it but for one key.

    `at`: the angle [rad], or s*; `error`: standard error; `low`, `high`: the 95 % interval, by Student's t on the
    degrees of freedom of both errors together (Welch and Satterthwaite). The plain hopper over itself is 1 without
    error.
    """

    result: PointResult
    over: PointResult
    at: float
    value: float
    error: float
    low: float
    high: float

    @property
    def runs(self) -> str:
        """`n = 3`, or `n = 2 and 3`: how many runs each of the two means has."""
        counts = [one.flow_rate.n for one in (self.result, self.over) if one.flow_rate is not None]
        return f"n = {' and '.join(map(str, dict.fromkeys(counts)))}"

    def holds(self, value: float) -> bool:
        """Whether a value lies inside the 95 % interval."""
        return self.low <= value <= self.high


def by_angle(points: Sequence[PointResult]) -> list[Ratio]:
    """W(angle) over W(90 deg), of outlets that are alike otherwise; nothing if no angle was swept."""
    swept = [one for one in points if ANGLE in one.at]
    return _ratios(swept, ANGLE, lambda hopper: hopper.flat, lambda hopper: hopper.angle)


def by_position(points: Sequence[PointResult]) -> list[Ratio]:
    """W over that of the same outlet in the middle, against s* = 2 s/(L - D), which is 0 at the wall and 1 there."""
    return _ratios(points, GAP, lambda hopper: hopper.gap is None, position)


RATIOS: Mapping[str, Callable[[Sequence[PointResult]], list[Ratio]]] = {
    "flow_ratio.angle": by_angle,
    "flow_ratio.position": by_position,
}
"""Over a flat bottom, and over an outlet in the middle; a reference can name them as it names a measurement."""


def position(hopper: WedgeHopper) -> float:
    """s* = 2 s/(L - D); 1 for an outlet in the middle."""
    return 1.0 if hopper.gap is None else 2 * hopper.gap / (hopper.width - hopper.orifice)


@dataclass(frozen=True)
class AngleLaw:
    """An angle factor without free parameters: its name, and W(angle)/W(90 deg) at an angle [rad]."""

    name: str
    factor: Callable[[float], float]

    @property
    def author(self) -> str:
        """The name without the number of the law."""
        return self.name.partition(",")[0]


def angle_laws(result: PointResult) -> tuple[AngleLaw, ...]:
    """Brown's law, and Rose and Tanaka's with the arctangent of the grains' friction for phi_d."""
    friction = math.atan(result.point.scene.contact.friction)
    found = [AngleLaw("Brown", brown)]
    if friction > 0:
        name = f"Rose & Tanaka, φ_d = {math.degrees(friction):.3g}°"
        found.append(AngleLaw(name, lambda angle: rose_tanaka(angle, friction)))
    return tuple(found)


def angle_factors(one: Ratio) -> dict[str, float]:
    """What each angle law gives at a point, by the friction of its own grains; by the law's author."""
    return {law.author: law.factor(one.at) for law in angle_laws(one.result)}


def authors(ratios: Sequence[Ratio]) -> list[str]:
    """Those of the angle laws that give something at some point."""
    return list(dict.fromkeys(author for one in ratios for author in angle_factors(one)))


def _ratios(
    points: Sequence[PointResult],
    key: str,
    plain: Callable[[WedgeHopper], bool],
    place: Callable[[WedgeHopper], float],
) -> list[Ratio]:
    groups: dict[tuple, list[PointResult]] = {}
    for one in points:
        if isinstance(one.point.scene.container, WedgeHopper) and one.flow_rate is not None:
            groups.setdefault(tuple((k, v) for k, v in one.at.items() if k != key), []).append(one)
    found = []
    for group in groups.values():
        reference = next((one for one in group if plain(_hopper(one))), None)
        if reference is None or len(group) < 2:
            continue
        found += [ratio_of_points(one, reference, place(_hopper(one))) for one in group]
    return found


def _hopper(result: PointResult) -> WedgeHopper:
    container = result.point.scene.container
    assert isinstance(container, WedgeHopper)
    return container


def ratio_of_points(one: PointResult, reference: PointResult, at: float) -> Ratio:
    if one is reference:
        return Ratio(one, reference, at, 1.0, 0.0, 1.0, 1.0)
    above, below = one.flow_rate, reference.flow_rate
    assert above is not None
    assert below is not None
    found = independent_ratio(above, below)
    return Ratio(one, reference, at, found.value, found.error, found.low, found.high)
