"""Series: points that differ only in their orifice, and the laws fitted to their flow rates."""

import math
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import ClassVar, Literal

import numpy as np

from labbook.fit import LAWS, Context, FitError, FitResult, Parameter, contenders, fit
from labbook.plugins import ExtensionError
from labbook.results import display
from labbook.results.outlets import by_outlet
from labbook.results.points import ORIFICE, PointResult, names_scene
from labbook.warning import RenamedAttribute

PACKING_FRACTION = "packing_fraction"
UNDECIDED = "undecided"


@dataclass(frozen=True, eq=False)
class FurtherFit:
    """Fit of a paper's own analysis to a series, beside the laws of the flow rate.

    Args:
        parameters: Fitted parameters by name.
        notes: Remarks that readers need.
        points: Fitted points.
    """

    formula: ClassVar[str]
    source: ClassVar[str]
    version: ClassVar[int]
    """Rises whenever fitted numbers may change."""
    parameters: Mapping[str, Parameter]
    notes: tuple[str, ...] = ()
    points: tuple[PointResult, ...] = ()


@dataclass(frozen=True)
class Residual:
    """Relative residual of a point, (W - W of the law) / W of the law.

    Args:
        orifice: Width or diameter of the outlet [m].
        value: The residual.
        half_width: Half-width of the point's own 95 % interval, relative to the law; infinite for one replicate.
        error: Standard error that fit and test use, pooled over points, relative to the law.
    """

    orifice: float
    value: float
    half_width: float
    error: float


@dataclass(frozen=True, eq=False)
class Series:
    """Points that differ in their orifice, and the laws fitted to them.

    Args:
        at: Swept values that all points share [SI or word], without the orifice.
        points: The points, in order of their orifice.
        fits: Fitted laws by name.
        used: Identities of the fitted points.
        flagged: Identities of fitted points outside a law's range or without steady flow.
        contenders: Laws among which the data do not decide; a single one is preferred. Empty with fewer than two fits.
        problems: Reasons that laws could not be fitted.
        unset: Keys that are swept elsewhere in the study and not set here.
        further: Fits of papers.
    """

    at: Mapping[str, float | str]
    points: tuple[PointResult, ...]
    fits: Mapping[str, FitResult]
    used: frozenset[Hashable]
    flagged: frozenset[Hashable]
    contenders: tuple[str, ...]
    problems: tuple[str, ...]
    unset: tuple[str, ...] = ()
    further: Mapping[str, FurtherFit] = field(default_factory=dict)
    """Fits of papers beside the laws of the flow rate, by name, if the study requests them."""
    of_one_form: bool = False
    """True if the points have outlets of both forms, and this series has those of one."""
    diameters = RenamedAttribute("orifices")

    def parameters(self, name: str) -> Mapping[str, Parameter]:
        """Fitted parameters of the law or further fit `name`; empty where it was not fitted."""
        fitted = {**self.fits, **self.further}.get(name)
        return fitted.parameters if fitted is not None else {}

    @property
    def label(self) -> str:
        """Swept values that the points have in common; empty if nothing else was swept."""
        return ", ".join(filter(None, (self.label_without(""), display.label(self.along))))

    @property
    def along(self) -> Mapping[str, float | str]:
        """Swept keys that follow from `at`, and say what the scene is."""
        first = self.points[0].along if self.points else {}
        return {
            name: value
            for name, value in first.items()
            if names_scene(name) and all(result.along.get(name) == value for result in self.points)
        }

    def label_without(self, key: str) -> str:
        """The label, leaving out what it says of `key`."""
        unset = [f"{display.key(name).name} not set" for name in self.unset if name != key]
        form = f"{self.outlet}s" if self.of_one_form else ""
        return ", ".join(filter(None, (display.label(self.at, {key}), form, *unset)))

    @property
    def outlet(self) -> Literal["slot", "hole"]:
        """Form of the outlet."""
        return "slot" if self.points[0].outlet_form == "slot" else "hole"

    @property
    def whole_points(self) -> tuple[PointResult, ...]:
        """The points, each once: a point of several outlets is in the series with each of them."""
        return tuple(dict.fromkeys(result.of_point for result in self.points))

    @property
    def orifices(self) -> list[float]:
        """Orifices [m]."""
        return [result.orifice for result in self.points]

    @property
    def preferred(self) -> str | None:
        """The law that the data choose, `undecided`, or None with fewer than two fits."""
        if not self.contenders:
            return None
        return self.contenders[0] if len(self.contenders) == 1 else UNDECIDED

    def residuals(self, law: str) -> tuple[Residual, ...]:
        """Residual of every point with a flow rate, in order of the orifice. Raises KeyError for a law without fit."""
        measured = [(result.orifice, result.flow_rate) for result in self.points if result.flow_rate is not None]
        fit = self.fits[law]
        expected, _, _ = fit.band(np.array([orifice for orifice, _ in measured]))
        errors = fit.relative_error * fit.W  # the same points in the same order
        return tuple(
            Residual(
                orifice,
                *(float(number) for number in (pooled.value / of_law - 1, pooled.half_width / of_law, error / of_law)),
            )
            for (orifice, pooled), of_law, error in zip(measured, expected, errors, strict=True)
        )

    def __repr__(self) -> str:
        fits = ", ".join((*self.fits, *self.further)) or "none"
        return f"<Series of {len(self.points)} points{f' at {self.label}' if self.label else ''}; fits: {fits}>"

    @property
    def verdict(self) -> str:
        """The law that the data prefer, in a sentence."""
        if not self.contenders:
            return ""
        left, beaten = self.contenders, [law for law in self.fits if law not in self.contenders]
        if len(left) == 1:
            return f"The data prefer {_listed(left)} to {_listed(beaten)} (AICc)."
        behind = f"; against {_listed(beaten)} they do (AICc)" if beaten else ""
        return f"The data do not decide between {_listed(left)}{behind}."


FitTo = Callable[[Sequence[PointResult]], FurtherFit]
"""Fits the points of a series; raises FitError, and ExtensionError where the code of another package fails."""


def series_of(
    points: Sequence[PointResult], laws: Sequence[str], further: Mapping[str, FitTo] = MappingProxyType({})
) -> tuple[Series, ...]:
    """Group points by what was swept beside the orifice, and fit `laws` to each group: those of the flow rate, and of
    others those that `further` has. Each of several outlets of a point counts as a point; points without the width of
    an orifice are left out."""
    groups: dict[tuple[tuple[tuple[str, float | str], ...], str | None], list[PointResult]] = {}
    for result in by_outlet(points):
        if math.isfinite(result.orifice):
            key = tuple((k, v) for k, v in result.at.items() if k != ORIFICE)
            groups.setdefault((key, result.outlet_form), []).append(result)
    ordered = sorted(groups.items(), key=lambda item: [(isinstance(v, str), v) for _, v in item[0][0]])
    names = dict.fromkeys(name for key, _ in groups for name, _ in key)
    all_series = (
        _series(dict(key), sorted(group, key=lambda r: r.orifice), laws, further) for (key, _), group in ordered
    )
    forms = Counter(key for key, _ in groups)
    return tuple(
        replace(
            each_series,
            unset=tuple(name for name in names if name not in each_series.at),
            of_one_form=forms[tuple(each_series.at.items())] > 1,
        )
        for each_series in all_series
    )


def _series(
    at: Mapping[str, float | str], points: Sequence[PointResult], laws: Sequence[str], further: Mapping[str, FitTo]
) -> Series:
    used = [(result, result.flow_rate) for result in points if result.flow_rate is not None]
    D = np.array([result.orifice for result, _ in used])
    W = np.array([pooled.value for _, pooled in used])
    error = np.array([pooled.error for _, pooled in used])
    replicates = np.array([pooled.n for _, pooled in used])
    fits: dict[str, FitResult] = {}
    problems = []
    outlet = points[0].outlet_form
    for name in (law for law in laws if law in LAWS):
        if LAWS[name].outlet not in (outlet, "any"):
            problems.append(f"{display.law(name)}: it is a law for a {LAWS[name].outlet}, and this is a {outlet}")
            continue
        try:
            with LAWS.calling(name, FitError):
                of_law = fit(LAWS[name], D, W, error, context(points), replicates)
            fits[name] = replace(of_law, notes=(*of_law.notes, *_lacking([result for result, _ in used])))
        except (FitError, ExtensionError) as failure:
            problems.append(f"{display.law(name)}: {str(failure).removeprefix(f'{name}: ')}")
    further_fits: dict[str, FurtherFit] = {}
    for name in (law for law in laws if law in further):
        try:
            further_fit = further[name](points)
            further_fits[name] = replace(further_fit, notes=(*further_fit.notes, *_lacking(further_fit.points)))
        except (FitError, ExtensionError) as failure:
            problems.append(f"{display.law(name)}: {failure}")
    outside = np.zeros(len(used), bool)
    for law_fit in fits.values():
        outside |= law_fit.outside
    flagged = {r.identity for (r, _), out in zip(used, outside, strict=True) if out or r.trending}
    left = contenders(list(fits.values())) if len(fits) > 1 else ()
    indices = frozenset(result.identity for result, _ in used)
    return Series(
        dict(at),
        tuple(points),
        fits,
        indices,
        frozenset(flagged),
        left,
        tuple(problems),
        further=further_fits,
    )


def _listed(laws: Iterable[str]) -> str:
    return " and ".join(display.law(law) for law in laws)


def _lacking(points: Sequence[PointResult]) -> tuple[str, ...]:
    """Notes on fitted points that lack runs, because they have not finished or clogged."""
    notes = []
    if partial := [f"{r.orifice * 1e3:g} mm with {len(r.runs)} of {r.requested} runs" for r in points if r.partial]:
        notes.append(f"fitted with missing runs: {', '.join(partial)}; runs that finish first are biased to fast flow")
    if clogged := sum(r.outcomes["clogged"] for r in points):
        alone = sum(r.flow_rate is not None and r.flow_rate.n == 1 for r in points)
        of_one = f"{alone} of {len(points)} points from one run; " if alone else ""
        runs = f"{clogged} clogged run{'' if clogged == 1 else 's'}"
        notes.append(f"{of_one}{runs} left out: survivors are biased to fast flow")
    return tuple(notes)


def context(points: Sequence[PointResult]) -> Context:
    """Properties of a series that the laws need. The packing fraction is the mean over points that measured it."""
    fractions = [r.pooled[PACKING_FRACTION].value for r in points if PACKING_FRACTION in r.pooled]
    return Context.of(points[0].point.scene, float(np.mean(fractions)) if fractions else None)
