"""The calibration that ships with labbook: what numerics did to the flow rate of scenes that were measured.

It is made by `labbook pilot` from the studies accuracy-hopper, accuracy-hole, accuracy-steps, accuracy-outlets and
accuracy-precision, and kept in calibration.json beside this file. It is keyed by dimensionless groups, and says nothing
of scenes beyond those that were measured. Effects differ from scene to scene by more than their errors: what is said of
one that was not measured has the scatter between those that were in its interval.
"""

import json
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from labbook.accuracy.groups import Groups
from labbook.stats.effects import FEWEST, one_more
from labbook.stats.pooling import student

PATH = Path(__file__).with_name("calibration.json")
BESIDE = ".calibration.json"
"""End of the name of the file with the calibration of a study beside that of the study, in place of .yaml."""
KINDS = ("shape", "outlet", "law", "version")
"""Groups that have to be those of the calibration."""
RANGES = ("friction", "restitution", "rolling", "ratio", "angle", "eccentricity", "rotation")
"""Groups that have to lie within its range, whatever the numerics are."""
NUMERICS = ("overlap", "step")
"""Groups that numerics decide; their range goes from 0 to where all scenes were measured."""
CONFIDENCE = 0.95
_TITLES = {"shape": "grains are", "outlet": "the outlet is a", "law": "the law is", "ratio": "D/d", "step": "dt/t_c",
           "rolling": "rolling friction", "overlap": "the overlap", "angle": "angle of the bottom [deg]",
           "eccentricity": "eccentricity of the outlet", "rotation": "rotation of the bottom"}  # fmt: skip


class OutOfRange(ValueError):
    """Groups beyond the calibration; the message says which."""


class NotMeasured(OutOfRange):
    """Neither this scene was measured, nor enough scenes of its kind and range: a pilot of it would tell."""


@dataclass(frozen=True)
class Bias:
    """Relative bias of a flow rate: best estimate, and half width of its interval at 95 %."""

    value: float
    half_width: float

    @property
    def bound(self) -> float:
        """|bias| + half width: what is not exceeded at 95 %."""
        return abs(self.value) + self.half_width

    def __add__(self, other: "Bias") -> "Bias":
        """Of two biases that were measured apart from one another."""
        return Bias(self.value + other.value, math.hypot(self.half_width, other.half_width))


@dataclass(frozen=True)
class Effects:
    """What was measured in one scene.

    `here`: its groups, with the largest overlap and step that were measured. `slopes` and `covariance`: see
    `labbook.accuracy.regression.Slopes`, with `freedom` degrees of freedom. `scatter`: standard deviation of ln W from
    seed to seed. `source`: study, backend and date, in words. `mixed`: what flow and filling in mixed precision do to
    ln W, with the variance of that; None where it was not measured. `curvature`: by squared overlap of the flow, as in
    `Slopes`; None where ln W is linear.
    """

    here: Groups
    slopes: tuple[float, float, float]
    covariance: tuple[tuple[float, ...], ...]
    freedom: int
    scatter: float
    source: str
    mixed: tuple[float, float] | None = None
    curvature: tuple[float, tuple[float, float, float, float]] | None = None

    @property
    def kinds(self) -> tuple[str | int, ...]:
        """Shape, outlet, law and its version."""
        return tuple(getattr(self.here, name) for name in KINDS)

    @property
    def scene(self) -> tuple[str | float, ...]:
        """What tells this scene from others: its kinds, and what has to lie within a range, to six digits."""
        return (*self.kinds, *(float(f"{getattr(self.here, name):.6g}") for name in RANGES))

    @property
    def soft(self) -> bool:
        """Whether the stiffness of the flow was varied."""
        return math.isfinite(self.covariance[0][0])

    def varied(self, name: str) -> bool:
        """Whether a group was varied; those that numerics do not decide always count as varied."""
        return {"overlap": self.soft, "step": self.stepped}.get(name, True)

    @property
    def stepped(self) -> bool:
        """Whether the time step was varied."""
        return math.isfinite(self.covariance[1][1])

    def of(self, x: np.ndarray) -> tuple[float, float]:
        """What a change `x` of overlap, squared step, overlap while filling and squared overlap, shape [4], does to
        ln W, and the variance of that; infinite where it was not measured."""
        moved = x != 0  # an effect that was never measured has an infinite variance, and matters only where it acts
        slopes, covariance = self.extended
        return float(x @ slopes), float(x[moved] @ covariance[np.ix_(moved, moved)] @ x[moved])

    @property
    def extended(self) -> tuple[np.ndarray, np.ndarray]:
        """Slopes with the curvature as the fourth, shape [4], and their covariance, shape [4, 4]; 0 where ln W is
        linear."""
        curvature, row = self.curvature or (0.0, (0.0,) * 4)
        covariance = np.zeros((4, 4))
        covariance[:3, :3] = self.covariance
        covariance[3] = covariance[:, 3] = row
        return np.array([*self.slopes, curvature]), covariance


@dataclass(frozen=True)
class Alike:
    """Effects in scenes of one shape, outlet, law and version of it."""

    effects: tuple[Effects, ...]
    rounded: tuple[tuple[float, float], ...] = ()
    """What mixed precision did to ln W, with the variance of that, wherever it was measured with grains of this shape:
    how numbers are rounded depends neither on the outlet nor on the law."""

    @property
    def scatter(self) -> float:
        """Standard deviation of ln W from seed to seed, of all scenes together."""
        return math.sqrt(float(np.mean([one.scatter**2 for one in self.effects])))

    @property
    def source(self) -> str:
        """Where the effects are from, in words."""
        return _sources(self.effects)

    def range(self, name: str) -> tuple[float, float]:
        """Smallest and largest value of a group; of what numerics decide, from 0 to where all scenes were measured.

        Scenes whose stiffness was not varied say what a step does in beds as soft as theirs, and bound no overlap.
        """
        varied = [one for one in self.effects if one.varied(name)]
        values = [getattr(one.here, name) for one in varied or self.effects]
        return (0.0, min(values) if varied else max(values)) if name in NUMERICS else (min(values), max(values))

    def misfits(self, here: Groups, names: tuple[str, ...]) -> Iterator[str]:
        """What of a scene was not measured: one phrase for each group of `names` and each kind."""
        for name, known in zip(KINDS, self.effects[0].kinds, strict=True):
            if (mine := getattr(here, name)) == known:
                continue
            if name != "version":
                yield f"{_TITLES[name]} {mine}, calibrated: {known}"
            elif here.law == self.effects[0].here.law:
                yield f"the law {here.law} has version {mine}, calibrated: version {known}"
        for name in names:
            low, high = self.range(name)
            if not low * (1 - 1e-6) <= getattr(here, name) <= high * (1 + 1e-6):
                span = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
                yield f"{_TITLES.get(name, name)} = {getattr(here, name):.3g}, calibrated: {span}"

    def bias(self, stated: Groups, flow: Groups, filled: Groups) -> Bias:
        """Bias of W computed with the numerics of `flow` in a bed filled with those of `filled`, against the stiffness
        of `stated` and an infinitely small step, in a scene that need not be among the measured ones.

        A scene that was measured has its own effects. Another is taken for one more of those that were: what these
        differ by is in its interval (`labbook.stats.effects`). Raises OutOfRange.
        """
        wrong = dict.fromkeys((*self.misfits(flow, (*RANGES, *NUMERICS)), *self.misfits(filled, NUMERICS)))
        if wrong:
            raise OutOfRange("; ".join(wrong))
        bent = flow.overlap**2 - stated.overlap**2
        x = (flow.overlap - stated.overlap, flow.step**2, filled.overlap - stated.overlap, bent)
        for effects in self.measured(flow):
            value, variance = effects.of(np.array(x))
            return Bias(value, student(CONFIDENCE, effects.freedom) * math.sqrt(variance))
        return _one_more(self, x)

    def measured(self, here: Groups) -> list[Effects]:
        """List the effects of this very scene: none where it is not among those that were measured."""

        def equal(effects: Effects) -> bool:
            return all(math.isclose(getattr(effects.here, n), getattr(here, n), rel_tol=1e-6) for n in RANGES)

        return list(filter(equal, self.effects))

    @property
    def mixed(self) -> Bias | None:
        """Bias of W computed in mixed precision; None where it was measured in fewer than FEWEST scenes."""
        return _rounding(self.rounded) if len(self.rounded) >= FEWEST else None


@lru_cache(maxsize=64)
def _rounding(rounded: tuple[tuple[float, float], ...]) -> Bias:
    values, variances = zip(*rounded, strict=True)
    return Bias(*one_more(values, variances, CONFIDENCE))


@lru_cache(maxsize=4096)  # the points of a study have the same numerics to choose from
def _one_more(alike: Alike, x: tuple[float, float, float, float]) -> Bias:
    found = [one.of(np.array(x)) for one in alike.effects]
    known = [(value, variance) for value, variance in found if math.isfinite(variance)]
    if len(known) < FEWEST:
        return Bias(float(np.mean([value for value, _ in known or found])), math.inf)
    values, variances = zip(*known, strict=True)
    return Bias(*one_more(values, variances, CONFIDENCE))


@dataclass(frozen=True)
class Calibration:
    """All that was measured; of what fits a scene the first counts."""

    known: tuple[Alike, ...]

    def of(self, here: Groups) -> Alike:
        """What was measured of scenes like this one. Raises NotMeasured."""
        wrong = []
        for one in self.known:
            found = list(one.misfits(here, RANGES))
            if not found and len(one.effects) < FEWEST and not one.measured(here):
                ratios = ", ".join(f"{effects.here.ratio:.3g}" for effects in one.effects)
                found = [f"only D/d = {ratios} calibrated, and an interval needs {FEWEST} scenes"]
            if not found:
                return replace(one, rounded=self._rounded(here.shape))
            wrong.append(found)
        raise NotMeasured("; ".join(min(wrong, key=len, default=["nothing was measured"])))

    def _rounded(self, shape: str) -> tuple[tuple[float, float], ...]:
        of_shape = [one for alike in self.known for one in alike.effects if one.here.shape == shape]
        return tuple(one.mixed for one in of_shape if one.mixed is not None)


def calibration(effects: Iterable[Effects]) -> Calibration:
    """Effects by their kinds; what was measured of one scene several times counts together."""
    scenes: dict[tuple[str | float, ...], Effects] = {}
    for one in effects:
        scenes[one.scene] = together(scenes[one.scene], one) if one.scene in scenes else one
    kinds: dict[tuple[str | int, ...], list[Effects]] = defaultdict(list)
    for one in scenes.values():
        kinds[one.kinds].append(one)
    return Calibration(tuple(Alike(tuple(some)) for some in kinds.values()))


def together(one: Effects, other: Effects) -> Effects:
    """What two measurements of one scene say together: slopes weighted by the inverse of their covariances. They hold
    up to the smaller of their largest steps, and up to the overlap of the one that varied it. Where one of them has a
    curvature, it is theirs."""
    inverses = [_information(each) for each in (one, other)]
    total = np.sum(inverses, axis=0)
    known = np.diag(total) > 0
    covariance = np.diag(np.where(known, 0.0, math.inf))
    covariance[np.ix_(known, known)] = np.linalg.inv(total[np.ix_(known, known)])
    slopes = np.zeros(4)
    weighted = np.sum([weight @ each.extended[0] for weight, each in zip(inverses, (one, other), strict=True)], axis=0)
    slopes[known] = covariance[np.ix_(known, known)] @ weighted[known]
    row = covariance[3].tolist()
    freedoms = one.freedom, other.freedom
    rounded = [each.mixed for each in (one, other) if each.mixed is not None]
    stepped = [each.here.step for each in (one, other) if each.stepped]
    soft = [each.here.overlap for each in (one, other) if each.soft]
    overlap = min(soft) if soft else max(one.here.overlap, other.here.overlap)
    return Effects(
        here=replace(one.here, overlap=overlap, step=min(stepped or [one.here.step, other.here.step])),
        slopes=(float(slopes[0]), float(slopes[1]), float(slopes[2])),
        covariance=tuple(map(tuple, covariance[:3, :3].tolist())),
        freedom=sum(freedoms),
        scatter=math.sqrt(float(np.average([one.scatter**2, other.scatter**2], weights=freedoms))),
        source=_sources((one, other)),
        mixed=_weighted(rounded) if rounded else None,
        curvature=(float(slopes[3]), (row[0], row[1], row[2], row[3])) if known[3] else None,
    )


def _weighted(found: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean of values with known variances, and its variance."""
    weights = [1 / variance for _, variance in found]
    mean = math.fsum(weight * value for weight, (value, _) in zip(weights, found, strict=True)) / math.fsum(weights)
    return mean, 1 / math.fsum(weights)


def _sources(effects: Iterable[Effects]) -> str:
    return "; ".join(dict.fromkeys(source for one in effects for source in one.source.split("; ")))


def _information(one: Effects) -> np.ndarray:
    """Inverse of the covariance, shape [4, 4]; 0 for what was not measured."""
    covariance, found = one.extended[1], np.zeros((4, 4))
    known = np.isfinite(np.diag(covariance)) & np.array([True, True, True, one.curvature is not None])
    found[np.ix_(known, known)] = np.linalg.inv(covariance[np.ix_(known, known)])
    return found


@cache
def shipped() -> Calibration:
    """The calibration that ships with labbook."""
    return read(json.loads(PATH.read_text(encoding="utf-8")))


def load(path: Path) -> Calibration:
    """The calibration in a file, and after it the one that ships. Raises OSError, or ValueError for a file of another
    kind."""
    return Calibration((*_read(path).known, *shipped().known))


def _read(path: Path) -> Calibration:
    try:
        return read(json.loads(path.read_text(encoding="utf-8")))
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"not a calibration file: {error!r}") from error


def read(stored: Mapping[str, Any]) -> Calibration:
    """The calibration in a file's JSON."""
    return calibration(
        Effects(
            here=Groups(**one["scene"]),
            slopes=tuple(one["slopes"]),
            covariance=tuple(tuple(math.inf if v is None else v for v in row) for row in one["covariance"]),
            freedom=one["freedom"],
            scatter=one["scatter"],
            source=one["source"],
            mixed=tuple(one["mixed"]) if "mixed" in one else None,
            curvature=(one["curvature"][0], tuple(one["curvature"][1])) if "curvature" in one else None,
        )
        for one in stored["effects"]
    )


def extend(path: Path, effects: Sequence[Effects]) -> None:
    """Write effects into a calibration file, which keeps those of other scenes. Raises OSError, and ValueError for a
    file of another kind."""
    scenes = {one.scene for one in effects}
    before = _read(path).known if path.is_file() else ()
    remaining = [one for alike in before for one in alike.effects if one.scene not in scenes]
    write(path, [*remaining, *effects])


def write(path: Path, effects: Iterable[Effects]) -> None:
    """Write a calibration file. Raises OSError."""
    entries = [
        {
            "scene": {name: value for name, value in asdict(one.here).items() if name != "version" or value > 1},
            "slopes": one.slopes,
            "covariance": [[None if math.isinf(v) else v for v in row] for row in one.covariance],
            "freedom": one.freedom,
            "scatter": one.scatter,
            "source": one.source,
            **({} if one.mixed is None else {"mixed": one.mixed}),
            **({} if one.curvature is None else {"curvature": one.curvature}),
        }
        for one in effects
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"effects": entries}, indent=1) + "\n", encoding="utf-8")
