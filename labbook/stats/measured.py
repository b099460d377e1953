"""A measured number, which is never a bare float."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Measured:
    """One quantity of one run, in SI.

    `error`: standard error from within the run, NaN where one run cannot tell (the error of a point is the
    seed-to-seed error of `labbook.stats.pool`). `n_effective`: the number of independent samples that would
    give the same error; regular outflow has more of them than it has grains. `window`: what was measured, in
    words. `method`: how value and error were found. `unit`: SI, empty for a pure number. `note`: what a
    reader must know, such as `trending`; notes are separated by semicolons.
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
        """The notes one by one."""
        return tuple(part.strip() for part in self.note.split(";") if part.strip())
