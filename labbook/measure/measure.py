"""What a measure is: the probes that it needs, the quantities that it gives, and how one finished run is evaluated."""

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
    """A measure cannot be taken of this scene or run; the message says why, `remedy` what would help."""

    def __init__(self, reason: str, remedy: str = ""):
        super().__init__(f"{reason}; {remedy}" if remedy else reason)
        self.reason, self.remedy = reason, remedy


class Window(Protocol):
    """Part of a discharge: from the fraction `start` to the fraction `end` of the initial mass discharged; if it is
    `timed`, from the time `start` to the time `end` after the opening [s]. Of a fed bed `end` is infinite.

    It may also have any of `labbook.measure.scales.KEYS`: times and lengths by which the outflow is measured. If it has
    `auto`, and that is true, it opens where the start-up of each run ends (`labbook.measure.startup`), not before
    `start`.
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
    """`0.15 to 0.6 of the mass discharged`, `the end of the start-up to 0.6 of the mass discharged`, or `0.5 s to
    3.5 s`; `what` is discharged."""
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

    `symbol` stands on axes and in headings (superscripts as ^(...)); `unit` is SI, as numbers are stored; `shown` is
    the unit that people read, if it is another, and `scale` the factor from SI to it. `pooled`: whether a mean over
    replicates means anything; that of a censored time would not. `estimator`: how replicates are pooled: by the `mean`
    over beds, or as a `rate`, events over exposure of all runs together (`labbook.stats.rates`), where `n_effective` of
    a run is its exposure. `about_zero`: whether a value that cannot be told from zero is a finding, and not a failure
    to determine it.
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
"""How names end of quantities of a run that clogged, taken while it flowed."""


def apart(run: "RunData") -> str:
    """How names of a run's quantities end: FLOWING of one that clogged, to keep them apart from runs that flowed
    throughout."""
    return FLOWING if run.outcome == "clogged" else ""


def while_flowing(quantity: Quantity) -> Quantity:
    """The same of a run that clogged, taken while it flowed, and kept apart from that of runs that did not clog."""
    return replace(
        quantity,
        name=f"{quantity.name}{FLOWING}",
        symbol=f"{quantity.symbol} of clogged runs while flowing",
        meaning=f"{quantity.meaning}, of clogged runs while they flowed",
    )


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What one measure gives of one run: `numbers`, and profiles, series or fields as `arrays` by name."""

    numbers: tuple[Measured, ...] = ()
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)


def packed(record: Any) -> dict[str, np.ndarray]:
    """The attributes of a record of numbers and arrays, as arrays by name."""
    return {name: np.asarray(value) for name, value in vars(record).items()}


def unpacked(kind: type[_Kind], arrays: Mapping[str, np.ndarray]) -> _Kind | None:
    """The record of that kind that `packed` made arrays of; None without any. Raises TypeError for those of another."""
    values: dict[str, Any] = {name: array if array.ndim else array.item() for name, array in arrays.items()}
    return kind(**values) if values else None


class Measure(ABC):
    """One kind of measurement."""

    name: ClassVar[str]
    version: ClassVar[int]
    """Rises whenever measured numbers may change; they are then derived again from what runs recorded."""
    declared: ClassVar[tuple[Quantity, ...]]
    """All quantities that it may give, in any scene, but for those whose names are those of parts of the scene."""
    needs_all: ClassVar[bool] = False
    """Needs all grains in the container at the opening: no stream may bring some of them later."""

    @abstractmethod
    def check(self, scene: Scene) -> None:
        """Raises MeasureError, with a remedy, for a scene that this cannot be measured in."""

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        """Those that it may give in `scene`: of `declared`, and those that are named after parts of the scene."""
        return self.declared

    @abstractmethod
    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        """What a backend must observe, on beats of `numerics`. Raises MeasureError for a scene that this cannot be
        measured in."""

    def observed(self, scene: Scene, numerics: Numerics, window: Window) -> tuple[Probe, ...]:
        """The probes of a study with this window, which may state more than `scene` and `numerics` tell. By default
        `probes`."""
        return self.probes(scene, numerics)

    def foreseen_empty(self, scene: Scene) -> tuple[str, str] | None:
        """Why it will probably give no number in `scene`, and the remedy; None, the default, if nothing speaks against
        it. For planning only."""
        return None

    @abstractmethod
    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        """What the run gives within the window. Raises MeasureError if the run did not record what is needed,
        ImportError if a package is missing."""
