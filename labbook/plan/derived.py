"""Numbers derived from a study, in words: mean sizes, and a stiffness that is stated by a collision."""

from collections.abc import Iterable, Iterator, Mapping

from labbook.scene import LinearSpringDashpot, Scene, Spheres
from labbook.scene.quantities import span
from labbook.study.point import Point


def derived(points: Iterable[Point]) -> Mapping[str, list[str]]:
    """Return lines about sizes and stiffness, with the labels of their points."""
    lines = dict[str, list[str]]()
    for point in points:
        for line in _lines(point.scene):
            lines.setdefault(line, []).append(point.label)
    return lines


def _lines(scene: Scene) -> Iterator[str]:
    grains, law = scene.grains, scene.contact
    if isinstance(grains, Spheres) and grains.graded:
        by_number, by_mass, mean = (
            f"{1e3 * size:.3g} mm"
            for size in (grains.mean_diameter, grains.mean_diameter_by_mass, grains.equivalent_diameter)
        )
        yield (
            f"Sizes: {1e3 * grains.finest:.3g} to {1e3 * grains.diameter:.3g} mm, mean {by_number} by number and "
            f"{by_mass} by mass; d = {1e3 * grains.diameter:.3g} mm is the largest, d* = {mean} that of the mean volume"
        )
    if isinstance(law, LinearSpringDashpot) and law.contact_time is not None:
        yield (
            f"Stiffness: k_n = {law.normal_stiffness:.4g} N/m, by a contact time of {span(law.contact_time)} of two of "
            "the lightest grains"
        )
    elif isinstance(law, LinearSpringDashpot) and law.largest_overlap is not None and law.impact_speed is not None:
        fraction = law.largest_overlap / grains.diameter
        yield (
            f"Stiffness: k_n = {law.normal_stiffness:.4g} N/m, by an overlap of {fraction:.3g} d of two of the "
            f"heaviest grains at {law.impact_speed:.3g} m/s"
        )
