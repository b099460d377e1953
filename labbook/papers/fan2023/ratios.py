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
    """W of a point over that of the plain hopper that differs from it in one key only.

    The plain hopper over itself is 1 without error.

    Args:
        result: The point.
        plain: The plain hopper.
        at: Angle [rad], or s*.
        value: The ratio.
        error: Standard error.
        low: Lower end of the 95 % interval, by Student's t with the degrees of freedom of both errors together (Welch
            and Satterthwaite).
        high: Upper end.
    """

    result: PointResult
    plain: PointResult
    at: float
    value: float
    error: float
    low: float
    high: float

    @property
    def runs(self) -> str:
        """Numbers of runs of both means: `n = 3`, or `n = 2 and 3`."""
        counts = [result.flow_rate.n for result in (self.result, self.plain) if result.flow_rate is not None]
        return f"n = {' and '.join(map(str, dict.fromkeys(counts)))}"

    def holds(self, value: float) -> bool:
        """True if a value lies inside the 95 % interval."""
        return self.low <= value <= self.high


def by_angle(points: Sequence[PointResult]) -> list[Ratio]:
    """W(angle) over W(90 deg), of outlets that are equal otherwise; empty if no angle was swept."""
    swept = [point for point in points if ANGLE in point.at]
    return _ratios(swept, ANGLE, lambda hopper: hopper.flat, lambda hopper: hopper.angle)


def by_position(points: Sequence[PointResult]) -> list[Ratio]:
    """W over that of the same outlet in the middle, against s* = 2 s/(L - D), 0 at the wall and 1 in the middle."""
    return _ratios(points, GAP, lambda hopper: hopper.gap is None, position)


RATIOS: Mapping[str, Callable[[Sequence[PointResult]], list[Ratio]]] = {
    "flow_ratio.angle": by_angle,
    "flow_ratio.position": by_position,
}
"""Ratios by quantity: over a flat bottom, and over an outlet in the middle; a reference can name them."""


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
    """Return Brown's law, and Rose and Tanaka's with the arctangent of the grains' friction for phi_d."""
    friction = math.atan(result.point.scene.contact.friction)
    laws = [AngleLaw("Brown", brown)]
    if friction > 0:
        name = f"Rose & Tanaka, φ_d = {math.degrees(friction):.3g}°"
        laws.append(AngleLaw(name, lambda angle: rose_tanaka(angle, friction)))
    return tuple(laws)


def angle_factors(ratio: Ratio) -> dict[str, float]:
    """Factor of each angle law at a point, with the friction of its own grains, by the law's author."""
    return {law.author: law.factor(ratio.at) for law in angle_laws(ratio.result)}


def authors(ratios: Sequence[Ratio]) -> list[str]:
    """Authors of the angle laws that apply to some point."""
    return list(dict.fromkeys(author for ratio in ratios for author in angle_factors(ratio)))


def _ratios(
    points: Sequence[PointResult],
    key: str,
    plain: Callable[[WedgeHopper], bool],
    position_of: Callable[[WedgeHopper], float],
) -> list[Ratio]:
    groups: dict[tuple, list[PointResult]] = {}
    for point in points:
        if isinstance(point.point.scene.container, WedgeHopper) and point.flow_rate is not None:
            groups.setdefault(tuple((k, v) for k, v in point.at.items() if k != key), []).append(point)
    ratios = []
    for group in groups.values():
        reference = next((point for point in group if plain(_hopper(point))), None)
        if reference is None or len(group) < 2:
            continue
        ratios += [ratio_of_points(point, reference, position_of(_hopper(point))) for point in group]
    return ratios


def _hopper(result: PointResult) -> WedgeHopper:
    container = result.point.scene.container
    assert isinstance(container, WedgeHopper)
    return container


def ratio_of_points(result: PointResult, reference: PointResult, at: float) -> Ratio:
    if result is reference:
        return Ratio(result, reference, at, 1.0, 0.0, 1.0, 1.0)
    above, below = result.flow_rate, reference.flow_rate
    assert above is not None
    assert below is not None
    ratio = independent_ratio(above, below)
    return Ratio(result, reference, at, ratio.value, ratio.error, ratio.low, ratio.high)
