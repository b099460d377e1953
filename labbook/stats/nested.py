"""Nested replicates: several discharges of each of several beds. Beds are independent of one another, discharges of one
bed are not, so that beds are the units of all statistics."""

from collections.abc import Iterable, Mapping, Sequence

START, LARGEST = 2, 8
"""Discharges of a bed at first and at most, where their number is looked for: one alone does not tell what the flow and
what the bed does, and beyond eight the beds decide how well a mean is known."""

Beds = Mapping[int, Sequence[float]]
"""The values of the discharges of each bed, by its seed; beds without any are left out."""


def by_bed(values: Iterable[tuple[int, float]]) -> dict[int, list[float]]:
    """Sort values of runs by the seed of their bed."""
    beds: dict[int, list[float]] = {}
    for seed, value in values:
        beds.setdefault(seed, []).append(value)
    return beds


def of_beds(beds: Beds) -> list[float]:
    """Give one value for each bed, the mean over its discharges, in the order of the beds."""
    return [sum(values) / len(values) for values in beds.values()]
