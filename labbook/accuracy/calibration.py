"""Calibration that ships with labbook: measured effects of numerics on the flow rate of scenes.

`labbook pilot` writes it from the studies accuracy-hopper, accuracy-hole, accuracy-steps, accuracy-outlets and
accuracy-precision to calibration.json beside this file. Its keys are dimensionless groups, and it does not extrapolate
beyond the measured scenes. Effects differ between scenes by more than their errors. So the interval for a scene that
was not measured includes the scatter between those that were.
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
from labbook.stats.effects import FEWEST, predict_effect
from labbook.stats.pooling import student

PATH = Path(__file__).with_name("calibration.json")
BESIDE = ".calibration.json"
"""Suffix of a study's own calibration file, in place of .yaml."""
KINDS = ("shape", "outlet", "law", "version")
"""Groups that have to equal those of the calibration."""
RANGES = ("friction", "restitution", "rolling", "ratio", "angle", "eccentricity", "rotation")
"""Groups that have to lie within the range of the calibration, whatever the numerics are."""
NUMERICS = ("overlap", "step")
"""Groups that numerics decide; their range goes from 0 to the smallest of the scenes' largest values."""
CONFIDENCE = 0.95
_TITLES = {"shape": "grains are", "outlet": "the outlet is a", "law": "the law is", "ratio": "D/d", "step": "dt/t_c",
           "rolling": "rolling friction", "overlap": "the overlap", "angle": "angle of the bottom [deg]",
           "eccentricity": "eccentricity of the outlet", "rotation": "rotation of the bottom"}  # fmt: skip


class OutOfRange(ValueError):
    """Groups beyond the calibration; the message names them."""


class NotMeasured(OutOfRange):
    """Neither this scene nor enough scenes of its kind and range were measured; a pilot of it would help."""


@dataclass(frozen=True)
class Bias:
    """Relative bias of a flow rate: best estimate, and half width of its interval at 95 %."""

    value: float
    half_width: float

    @property
    def bound(self) -> float:
        """Limit that the bias does not exceed at 95 %: |bias| + half width."""
        return abs(self.value) + self.half_width

    def __add__(self, other: "Bias") -> "Bias":
        """Add two biases that were measured independently."""
        return Bias(self.value + other.value, math.hypot(self.half_width, other.half_width))


@dataclass(frozen=True)
class Effects:
    """Measured effects of numerics in one scene.

    Args:
        here: Groups of the scene, with the largest overlap and step that were measured.
        slopes: See `labbook.accuracy.regression.Slopes`.
        covariance: Of the slopes, shape [3, 3].
        freedom: Degrees of freedom of slopes and covariance.
        scatter: Standard deviation of ln W from seed to seed.
        source: Study, backend and date, in words.
        mixed: Effect of flow and filling in mixed precision on ln W, and its variance; None if it was not measured.
        curvature: By squared overlap of the flow, as in `Slopes`; None where ln W is linear.
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
        """Identity of the scene: its kinds, and the groups of RANGES to six digits."""
        return (*self.kinds, *(float(f"{getattr(self.here, name):.6g}") for name in RANGES))

    @property
    def soft(self) -> bool:
        """True if the stiffness of the flow was varied."""
        return math.isfinite(self.covariance[0][0])

    def varied(self, name: str) -> bool:
        """True if a group was varied; groups that numerics do not decide always count as varied."""
        return {"overlap": self.soft, "step": self.stepped}.get(name, True)

    @property
    def stepped(self) -> bool:
        """True if the time step was varied."""
        return math.isfinite(self.covariance[1][1])

    def of(self, x: np.ndarray) -> tuple[float, float]:
        """Effect of a change of numerics on ln W.

        Args:
            x: Changes of overlap, squared step, overlap while filling and squared overlap, shape [4].

        Returns:
            The change of ln W and its variance; infinite where it was not measured.
        """
        moved = x != 0  # an effect that was never measured has an infinite variance, and matters only where it acts
        slopes, covariance = self.extended
        return float(x @ slopes), float(x[moved] @ covariance[np.ix_(moved, moved)] @ x[moved])

    @property
    def extended(self) -> tuple[np.ndarray, np.ndarray]:
        """Slopes with the curvature as the fourth, shape [4], and their covariance, shape [4, 4].

        The curvature and its variances are 0 where ln W is linear.
        """
        curvature, row = self.curvature or (0.0, (0.0,) * 4)
        covariance = np.zeros((4, 4))
        covariance[:3, :3] = self.covariance
        covariance[3] = covariance[:, 3] = row
        return np.array([*self.slopes, curvature]), covariance


@dataclass(frozen=True)
class SimilarScenes:
    """Effects in scenes of one shape, outlet, law and version of the law."""

    effects: tuple[Effects, ...]
    rounded: tuple[tuple[float, float], ...] = ()
    """Effect of mixed precision on ln W, and its variance, of each measured scene with grains of this shape.

    Rounding depends neither on the outlet nor on the law, so scenes of all outlets and laws count.
    """

    @property
    def scatter(self) -> float:
        """Standard deviation of ln W from seed to seed, of all scenes together."""
        return math.sqrt(float(np.mean([effects.scatter**2 for effects in self.effects])))

    @property
    def source(self) -> str:
        """Sources of the effects, in words."""
        return _sources(self.effects)

    def range(self, name: str) -> tuple[float, float]:
        """Range of a group.

        Scenes whose stiffness was not varied give the effect of a step in beds as soft as theirs. They do not limit the
        overlap.

        Returns:
            Smallest and largest value; for groups that numerics decide, 0 and the smallest of the scenes' largest
            values.
        """
        varied = [effects for effects in self.effects if effects.varied(name)]
        values = [getattr(effects.here, name) for effects in varied or self.effects]
        return (0.0, min(values) if varied else max(values)) if name in NUMERICS else (min(values), max(values))

    def misfits(self, here: Groups, names: tuple[str, ...]) -> Iterator[str]:
        """Yield a phrase for each kind of a scene, and each group of `names`, that the calibration does not cover."""
        for name, calibrated in zip(KINDS, self.effects[0].kinds, strict=True):
            if (mine := getattr(here, name)) == calibrated:
                continue
            if name != "version":
                yield f"{_TITLES[name]} {mine}, calibrated: {calibrated}"
            elif here.law == self.effects[0].here.law:
                yield f"the law {here.law} has version {mine}, calibrated: version {calibrated}"
        for name in names:
            low, high = self.range(name)
            if not low * (1 - 1e-6) <= getattr(here, name) <= high * (1 + 1e-6):
                span = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
                yield f"{_TITLES.get(name, name)} = {getattr(here, name):.3g}, calibrated: {span}"

    def bias(self, nominal: Groups, flow: Groups, filled: Groups) -> Bias:
        """Bias of W in a scene that need not be among the measured ones.

        A measured scene has its own effects. Another scene is treated as a further sample of the measured ones, so that
        its interval includes the scatter between them (`labbook.stats.effects`).

        Args:
            nominal: Groups of the scene with its stated stiffness, against which the bias is taken, at step 0.
            flow: Groups with the numerics of the flow.
            filled: Groups with the numerics of the filling.

        Returns:
            The bias, as a part of W.

        Raises:
            OutOfRange: The groups lie beyond the calibration.
        """
        wrong = dict.fromkeys((*self.misfits(flow, (*RANGES, *NUMERICS)), *self.misfits(filled, NUMERICS)))
        if wrong:
            raise OutOfRange("; ".join(wrong))
        bent = flow.overlap**2 - nominal.overlap**2
        x = (flow.overlap - nominal.overlap, flow.step**2, filled.overlap - nominal.overlap, bent)
        for effects in self.measured(flow):
            value, variance = effects.of(np.array(x))
            return Bias(value, student(CONFIDENCE, effects.freedom) * math.sqrt(variance))
        return _predict(self, x)

    def measured(self, here: Groups) -> list[Effects]:
        """List the effects of this very scene; empty if it is not among the measured ones."""

        def equal(effects: Effects) -> bool:
            return all(math.isclose(getattr(effects.here, n), getattr(here, n), rel_tol=1e-6) for n in RANGES)

        return list(filter(equal, self.effects))

    @property
    def mixed(self) -> Bias | None:
        """Bias of W in mixed precision; None if it was measured in fewer than FEWEST scenes."""
        return _rounding(self.rounded) if len(self.rounded) >= FEWEST else None


@lru_cache(maxsize=64)
def _rounding(rounded: tuple[tuple[float, float], ...]) -> Bias:
    values, variances = zip(*rounded, strict=True)
    return Bias(*predict_effect(values, variances, CONFIDENCE))


@lru_cache(maxsize=4096)  # the points of a study have the same numerics to choose from
def _predict(scenes: SimilarScenes, x: tuple[float, float, float, float]) -> Bias:
    changes = [effects.of(np.array(x)) for effects in scenes.effects]
    measured = [(value, variance) for value, variance in changes if math.isfinite(variance)]
    if len(measured) < FEWEST:
        return Bias(float(np.mean([value for value, _ in measured or changes])), math.inf)
    values, variances = zip(*measured, strict=True)
    return Bias(*predict_effect(values, variances, CONFIDENCE))


@dataclass(frozen=True)
class Calibration:
    """Effects of numerics by kind of scene; the first entry that fits a scene counts.

    `similar`: entries, one for each combination of shape, outlet, law and version of the law.
    """

    similar: tuple[SimilarScenes, ...]

    def of(self, here: Groups) -> SimilarScenes:
        """Find the effects in scenes like this one. Raises NotMeasured if there are too few."""
        wrong = []
        for scenes in self.similar:
            misfits = list(scenes.misfits(here, RANGES))
            if not misfits and len(scenes.effects) < FEWEST and not scenes.measured(here):
                ratios = ", ".join(f"{effects.here.ratio:.3g}" for effects in scenes.effects)
                misfits = [f"only D/d = {ratios} calibrated, and an interval needs {FEWEST} scenes"]
            if not misfits:
                return replace(scenes, rounded=self._rounded(here.shape))
            wrong.append(misfits)
        raise NotMeasured("; ".join(min(wrong, key=len, default=["nothing was measured"])))

    def _rounded(self, shape: str) -> tuple[tuple[float, float], ...]:
        of_shape = [effects for scenes in self.similar for effects in scenes.effects if effects.here.shape == shape]
        return tuple(effects.mixed for effects in of_shape if effects.mixed is not None)


def calibration(effects: Iterable[Effects]) -> Calibration:
    """Group effects by kind of scene; repeated measurements of one scene are combined."""
    scenes: dict[tuple[str | float, ...], Effects] = {}
    for entry in effects:
        scenes[entry.scene] = combine(scenes[entry.scene], entry) if entry.scene in scenes else entry
    kinds: dict[tuple[str | int, ...], list[Effects]] = defaultdict(list)
    for entry in scenes.values():
        kinds[entry.kinds].append(entry)
    return Calibration(tuple(SimilarScenes(tuple(group)) for group in kinds.values()))


def combine(first: Effects, second: Effects) -> Effects:
    """Combine two measurements of one scene: slopes are weighted by the inverse of their covariances.

    The result holds up to the smaller of their largest steps, and up to the overlap of the one that varied it. It has a
    curvature if one of them has.
    """
    inverses = [_information(effects) for effects in (first, second)]
    total = np.sum(inverses, axis=0)
    measured = np.diag(total) > 0
    covariance = np.diag(np.where(measured, 0.0, math.inf))
    # slopes that neither varied have no information: their rows would make the matrix singular
    covariance[np.ix_(measured, measured)] = np.linalg.inv(total[np.ix_(measured, measured)])
    slopes = np.zeros(4)
    weighted = np.sum(
        [weight @ effects.extended[0] for weight, effects in zip(inverses, (first, second), strict=True)], axis=0
    )
    slopes[measured] = covariance[np.ix_(measured, measured)] @ weighted[measured]
    row = covariance[3].tolist()
    freedoms = first.freedom, second.freedom
    rounded = [effects.mixed for effects in (first, second) if effects.mixed is not None]
    stepped = [effects.here.step for effects in (first, second) if effects.stepped]
    soft = [effects.here.overlap for effects in (first, second) if effects.soft]
    overlap = min(soft) if soft else max(first.here.overlap, second.here.overlap)
    return Effects(
        here=replace(first.here, overlap=overlap, step=min(stepped or [first.here.step, second.here.step])),
        slopes=(float(slopes[0]), float(slopes[1]), float(slopes[2])),
        covariance=tuple(map(tuple, covariance[:3, :3].tolist())),
        freedom=sum(freedoms),
        scatter=math.sqrt(float(np.average([first.scatter**2, second.scatter**2], weights=freedoms))),
        source=_sources((first, second)),
        mixed=_weighted(rounded) if rounded else None,
        curvature=(float(slopes[3]), (row[0], row[1], row[2], row[3])) if measured[3] else None,
    )


def _weighted(numbers: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Average values by the inverse of their known variances, and give the variance of that mean."""
    weights = [1 / variance for _, variance in numbers]
    mean = math.fsum(weight * value for weight, (value, _) in zip(weights, numbers, strict=True)) / math.fsum(weights)
    return mean, 1 / math.fsum(weights)


def _sources(effects: Iterable[Effects]) -> str:
    return "; ".join(dict.fromkeys(source for entry in effects for source in entry.source.split("; ")))


def _information(effects: Effects) -> np.ndarray:
    """Inverse of the covariance, shape [4, 4]; 0 for slopes that were not measured."""
    covariance, inverse = effects.extended[1], np.zeros((4, 4))
    measured = np.isfinite(np.diag(covariance)) & np.array([True, True, True, effects.curvature is not None])
    inverse[np.ix_(measured, measured)] = np.linalg.inv(covariance[np.ix_(measured, measured)])
    return inverse


@cache
def shipped() -> Calibration:
    """Load the calibration that ships with labbook."""
    return read(json.loads(PATH.read_text(encoding="utf-8")))


def load(path: Path) -> Calibration:
    """Load the calibration in a file, followed by the one that ships.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is no calibration.
    """
    return Calibration((*_read(path).similar, *shipped().similar))


def _read(path: Path) -> Calibration:
    try:
        return read(json.loads(path.read_text(encoding="utf-8")))
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"not a calibration file: {error!r}") from error


def read(stored: Mapping[str, Any]) -> Calibration:
    """Build a calibration from the JSON of its file."""
    return calibration(
        Effects(
            here=Groups(**entry["scene"]),
            slopes=tuple(entry["slopes"]),
            covariance=tuple(tuple(math.inf if v is None else v for v in row) for row in entry["covariance"]),
            freedom=entry["freedom"],
            scatter=entry["scatter"],
            source=entry["source"],
            mixed=tuple(entry["mixed"]) if "mixed" in entry else None,
            curvature=(entry["curvature"][0], tuple(entry["curvature"][1])) if "curvature" in entry else None,
        )
        for entry in stored["effects"]
    )


def extend(path: Path, effects: Sequence[Effects]) -> None:
    """Add effects to a calibration file; those of the same scenes are replaced.

    Raises:
        OSError: The file cannot be read or written.
        ValueError: The file is no calibration.
    """
    replaced = {entry.scene for entry in effects}
    before = _read(path).similar if path.is_file() else ()
    remaining = [entry for scenes in before for entry in scenes.effects if entry.scene not in replaced]
    write(path, [*remaining, *effects])


def write(path: Path, effects: Iterable[Effects]) -> None:
    """Write a calibration file. Raises OSError."""
    entries = [
        {
            "scene": {name: value for name, value in asdict(entry.here).items() if name != "version" or value > 1},
            "slopes": entry.slopes,
            "covariance": [[None if math.isinf(v) else v for v in row] for row in entry.covariance],
            "freedom": entry.freedom,
            "scatter": entry.scatter,
            "source": entry.source,
            **({} if entry.mixed is None else {"mixed": entry.mixed}),
            **({} if entry.curvature is None else {"curvature": entry.curvature}),
        }
        for entry in effects
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"effects": entries}, indent=1) + "\n", encoding="utf-8")
