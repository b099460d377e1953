"""Base class of measures: the probes that a measure needs, its quantities, and its evaluation of a finished run."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, Protocol, TypeVar

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.measure.data import RunData
from labbook.scene import Scene
from labbook.stats import Measured

_Kind = TypeVar("_Kind")


class MeasureError(ValueError):
    """A measure cannot be taken of this scene or run.

    Args:
        reason: The reason, such as `flow_rate needs an outlet`.
        remedy: The remedy; empty if there is none.
    """

    def __init__(self, reason: str, remedy: str = ""):
        super().__init__(f"{reason}; {remedy}" if remedy else reason)
        self.reason, self.remedy = reason, remedy


class Window(Protocol):
    """Part of a discharge in which measures are taken.

    It may also have any of `labbook.measure.scales.KEYS`: times and lengths by which the outflow is measured. If it has
    `auto`, and that is true, it opens where the start-up of each run ends (`labbook.measure.startup`), not before
    `start`.

    Attributes:
        start: Begin of the window, as a fraction of the initial mass discharged; of a timed window the time after the
            opening [s].
        end: End of the window, in the same unit; infinite for a fed bed.
        timed: True if `start` and `end` are times.
    """

    @property
    def start(self) -> float: ...

    @property
    def end(self) -> float: ...

    @property
    def timed(self) -> bool: ...


def after_start_up(window: Window) -> bool:
    """True for a window that opens where the start-up of each run ends."""
    return bool(getattr(window, "auto", False))


def window_in_words(window: Window, amount: str = "mass") -> str:
    """Describe a window.

    Args:
        window: The window.
        amount: Word for the discharged amount: `mass` or `grains`.

    Returns:
        `0.15 to 0.6 of the mass discharged`, `the end of the start-up to 0.6 of the mass discharged`, or `0.5 s to
        3.5 s`.
    """
    if after_start_up(window):
        return f"the end of the start-up to {window.end:.3g} of the {amount} discharged"
    if window.timed:
        return f"{window.start:.4g} s to {window.end:.4g} s"
    if math.isinf(window.end):
        return f"{window.start:.3g} of the {amount} discharged to the end of the run"
    return f"{window.start:.3g} to {window.end:.3g} of the {amount} discharged"


@dataclass(frozen=True)
class Quantity:
    """A number that a measure gives, declared once for the catalogue, tables, figures and references.

    Attributes:
        name: Name in studies, tables and the catalogue.
        symbol: Symbol on axes and in headings, with superscripts as ^(...).
        unit: SI unit, as numbers are stored; empty for a pure number.
        meaning: Meaning in a phrase.
        shown: Unit of reports, if it is not the SI unit.
        scale: Factor from the SI unit to that of reports.
        pooled: True if a mean over replicates is meaningful; that of a censored time is not.
        about_zero: True if a value compatible with zero is a result, and not a failure to determine it.
        estimator: `mean` pools replicates by the mean over beds; `rate` by events over exposure of all runs together
            (`labbook.stats.rates`), where `n_effective` of a run is its exposure.
    """

    name: str
    symbol: str
    unit: str = ""
    meaning: str = ""
    shown: str = ""
    scale: float = 1.0
    pooled: bool = True
    about_zero: bool = False
    estimator: Literal["mean", "rate"] = "mean"


FLOWING = "_flowing"
"""Suffix of quantities of a run that clogged, taken while it flowed."""


def flow_suffix(run: "RunData") -> str:
    """Return the suffix of a run's quantities: FLOWING for a run that clogged, else empty.

    It keeps them apart from those of runs that flowed throughout.
    """
    return FLOWING if run.outcome == "clogged" else ""


def while_flowing(quantity: Quantity) -> Quantity:
    """Declare the same quantity of runs that clogged, taken while they flowed (see `flow_suffix`)."""
    return replace(
        quantity,
        name=f"{quantity.name}{FLOWING}",
        symbol=f"{quantity.symbol} of clogged runs while flowing",
        meaning=f"{quantity.meaning}, of clogged runs while they flowed",
    )


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Result of a measure for one run.

    Attributes:
        numbers: Numbers of declared quantities [SI].
        arrays: Profiles, series or fields by name [SI]; the docstring of the measure states shapes and units.
    """

    numbers: tuple[Measured, ...] = ()
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)


def as_arrays(record: Any) -> dict[str, np.ndarray]:
    """Convert a record of numbers and arrays to arrays by the names of its attributes."""
    return {name: np.asarray(value) for name, value in vars(record).items()}


def from_arrays(kind: type[_Kind], arrays: Mapping[str, np.ndarray]) -> _Kind | None:
    """Convert arrays of `as_arrays` back to the record.

    Args:
        kind: Class of the record.
        arrays: Arrays by the names of its attributes.

    Returns:
        The record; None without arrays.

    Raises:
        TypeError: The arrays are those of another class.
    """
    values: dict[str, Any] = {name: array if array.ndim else array.item() for name, array in arrays.items()}
    return kind(**values) if values else None


class Measure(ABC):
    """Base class of measures, which turn what probes recorded of a run into numbers and arrays.

    A measure has no state: `evaluate` depends on the run and the window alone, and is called from several threads.

    Attributes:
        name: Name under `measure` in studies.
        version: Version; raise it whenever measured numbers may change. They are then derived again from the recorded
            data.
        declared: All quantities that it may give in any scene, except those named after parts of the scene.
        needs_all: True if all grains have to be in the container at the opening: no stream may bring some later.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    declared: ClassVar[tuple[Quantity, ...]]
    needs_all: ClassVar[bool] = False

    @abstractmethod
    def check(self, scene: Scene) -> None:
        """Check that the measure applies to a scene.

        Raises:
            MeasureError: It does not; the error has a remedy.
        """

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        """List the quantities that it may give in a scene, with those named after parts of the scene."""
        return self.declared

    @abstractmethod
    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        """List the probes that a backend must record.

        Args:
            scene: The scene.
            numerics: Numerics of the run: probes sample on multiples of its beat.

        Raises:
            MeasureError: The measure does not apply to the scene.
        """

    def observed(self, scene: Scene, numerics: Numerics, window: Window) -> tuple[Probe, ...]:
        """List the probes for a study with this window, where they depend on its times and lengths.

        Returns:
            By default those of `probes`.

        Raises:
            MeasureError: The measure does not apply to the scene.
        """
        return self.probes(scene, numerics)

    def foreseen_empty(self, scene: Scene) -> tuple[str, str] | None:
        """Forecast, for plans only, that the measure will give no number in a scene.

        Returns:
            The reason and the remedy; None, the default, if no obstacle is expected.
        """
        return None

    @abstractmethod
    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        """Evaluate a finished run within a window.

        Returns:
            Numbers and arrays; a number that the run does not determine is NaN with a note.

        Raises:
            MeasureError: The run lacks the data of a probe.
            ImportError: An optional package is missing.
        """
