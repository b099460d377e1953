"""The calibration that ships with labbook: what numerics did to the flow rate of scenes that were measured.

It is made by `labbook calibrate studies/accuracy-hopper.yaml`, and kept in calibration.json beside this file. It is
keyed by dimensionless groups, and says nothing of scenes beyond those that were measured.
"""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from labbook.accuracy.groups import Groups
from labbook.stats.pooling import student

PATH = Path(__file__).with_name("calibration.json")
KINDS = ("shape", "outlet", "law")
"""Groups that have to be those of the calibration."""
RANGES = ("friction", "restitution", "rolling", "ratio")
"""Groups that have to lie within its range, whatever the numerics are."""
NUMERICS = ("overlap", "step")
"""Groups that numerics decide; their range begins at 0."""
CONFIDENCE = 0.95
_TITLES = {"shape": "grains are", "outlet": "the outlet is a", "law": "the law is", "ratio": "D/d", "step": "dt/t_c",
           "rolling": "rolling friction", "overlap": "the overlap"}  # fmt: skip


class OutOfRange(ValueError):
    """Groups beyond the calibration; the message says which."""


@dataclass(frozen=True)
class Bias:
    """Relative bias of a flow rate: best estimate, and half width of its interval at 95 %."""

    value: float
    half_width: float

    @property
    def bound(self) -> float:
        """|bias| + half width: what is not exceeded at 95 %."""
        return abs(self.value) + self.half_width


@dataclass(frozen=True)
class Effects:
    """What was measured of one kind of scenes.

    `kinds`: shape, outlet and law; `ranges`: smallest and largest of each group that was measured. `slopes` and
    `covariance`: see `labbook.accuracy.regression.Slopes`, with `freedom` degrees of freedom. `scatter`: standard
    deviation of ln W from seed to seed. `source`: study, backend and date, in words.
    """

    kinds: Mapping[str, str]
    ranges: Mapping[str, tuple[float, float]]
    slopes: tuple[float, float, float]
    covariance: tuple[tuple[float, ...], ...]
    freedom: int
    scatter: float
    source: str

    def misfits(self, here: Groups, names: tuple[str, ...]) -> Iterator[str]:
        """What of a scene was not measured: one phrase for each group of `names` and each kind."""
        for name, known in self.kinds.items():
            if getattr(here, name) != known:
                yield f"{_TITLES[name]} {getattr(here, name)}, calibrated: {known}"
        for name in names:
            low, high = self.ranges[name]
            if not low * (1 - 1e-6) <= getattr(here, name) <= high * (1 + 1e-6):
                span = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
                yield f"{_TITLES.get(name, name)} = {getattr(here, name):.3g}, calibrated: {span}"

    def bias(self, stated: Groups, flow: Groups, filled: Groups) -> Bias:
        """Bias of W computed with the numerics of `flow` in a bed filled with those of `filled`, against the
        stiffness of `stated` and an infinitely small step. Raises OutOfRange."""
        wrong = dict.fromkeys((*self.misfits(flow, (*RANGES, *NUMERICS)), *self.misfits(filled, NUMERICS)))
        if wrong:
            raise OutOfRange("; ".join(wrong))
        x = np.array([flow.overlap - stated.overlap, flow.step**2, filled.overlap - stated.overlap])
        moved = x != 0  # an effect that was never measured has an infinite variance, and matters only where it acts
        covariance = np.asarray(self.covariance)[np.ix_(moved, moved)]
        error = math.sqrt(float(x[moved] @ covariance @ x[moved]))
        return Bias(float(x @ self.slopes), student(CONFIDENCE, self.freedom) * error)


@dataclass(frozen=True)
class Calibration:
    """All that was measured."""

    effects: tuple[Effects, ...]

    def of(self, here: Groups) -> Effects:
        """What was measured of scenes like this one. Raises OutOfRange."""
        wrong = []
        for one in self.effects:
            found = list(one.misfits(here, RANGES))
            if not found:
                return one
            wrong.append(found)
        raise OutOfRange("; ".join(min(wrong, key=len, default=["nothing was measured"])))


@cache
def shipped() -> Calibration:
    """The calibration that ships with labbook."""
    return read(json.loads(PATH.read_text(encoding="utf-8")))


def load(path: Path) -> Calibration:
    """The calibration in a file, and after it the one that ships. Raises OSError, or ValueError for a file of another
    kind."""
    try:
        own = read(json.loads(path.read_text(encoding="utf-8")))
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"it is no calibration: {error!r}") from error
    return Calibration((*own.effects, *shipped().effects))


def read(stored: Mapping[str, Any]) -> Calibration:
    """The calibration in a file's JSON."""
    return Calibration(
        tuple(
            Effects(
                kinds=dict(one["kinds"]),
                ranges={name: (low, high) for name, (low, high) in one["ranges"].items()},
                slopes=tuple(one["slopes"]),
                covariance=tuple(tuple(math.inf if v is None else v for v in row) for row in one["covariance"]),
                freedom=one["freedom"],
                scatter=one["scatter"],
                source=one["source"],
            )
            for one in stored["effects"]
        )
    )
