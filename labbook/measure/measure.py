"""What a measure is: the probes that it needs, and numbers from one finished run."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, Protocol

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.measure.data import RunData
from labbook.scene import Scene
from labbook.stats import Measured


class MeasureError(ValueError):
    """A measure cannot be taken of this scene or run; the message says why, `remedy` what would help."""

    def __init__(self, reason: str, remedy: str = ""):
        super().__init__(f"{reason}; {remedy}" if remedy else reason)
        self.reason, self.remedy = reason, remedy


class Window(Protocol):
    """Part of a discharge: from the fraction `start` to the fraction `end` of the initial mass discharged."""

    @property
    def start(self) -> float: ...

    @property
    def end(self) -> float: ...


class Measure(ABC):
    """One kind of measurement."""

    name: ClassVar[str]
    version: ClassVar[int]
    """Rises whenever measured numbers may change; they are then derived again from what runs recorded."""

    @abstractmethod
    def check(self, scene: Scene) -> None:
        """Raises MeasureError, with a remedy, for a scene that this cannot be measured in."""

    @abstractmethod
    def quantities(self, scene: Scene) -> Mapping[str, str]:
        """Names of the numbers that it may give in `scene`, and their SI units."""

    @abstractmethod
    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        """What a backend must observe, on beats of `numerics`. Raises MeasureError for a scene that this cannot be
        measured in."""

    @abstractmethod
    def evaluate(self, run: RunData, window: Window) -> tuple[Measured, ...]:
        """The numbers of one run. Raises MeasureError if the run did not record what is needed."""
