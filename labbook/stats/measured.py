"""Measured number: a value with error, unit and method."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Measured:
    """One quantity of one run, in SI.

    Attributes:
        quantity: Name of the quantity.
        value: The value.
        error: Standard error from within the run; NaN if one run cannot give it. The error of a point is the
            seed-to-seed error of `labbook.stats.pool`.
        n_effective: Number of independent samples with the same error; regular outflow has more of them than grains.
        window: Measured part of the run, in words.
        method: Method of value and error, in words.
        unit: SI unit; empty for a pure number.
        note: Warnings for the reader, such as `trending`, separated by semicolons.
    """

    quantity: str
    value: float
    error: float
    n_effective: float
    window: str
    method: str
    unit: str
    note: str = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes as a tuple, split at the semicolons."""
        return tuple(part.strip() for part in self.note.split(";") if part.strip())
