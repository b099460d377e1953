"""Points with several outlets, outlet by outlet: series, fits and clogging take each as a point of its own width."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

from labbook.measure.clogging import Clogging, outlet_suffix
from labbook.measure.outlets import OutletRates
from labbook.results.points import FLOW_RATE, PointResult
from labbook.scene import Outlet
from labbook.stats import Pooled
from labbook.warning import RenamedAttribute


@dataclass(frozen=True, eq=False)
class OutletResult(PointResult):
    """One of several outlets of a point.

    Args:
        whole: The point.
        outlet_index: Index of the outlet in its container.
    """

    whole: PointResult | None = None
    outlet_index: int = 0
    place = RenamedAttribute("outlet_index")

    @property
    def outlet(self) -> Outlet:
        """The outlet."""
        return self.point.scene.container.outlets[self.outlet_index]

    @property
    def of_point(self) -> PointResult:
        """The point with all of its outlets."""
        assert self.whole is not None
        return self.whole

    @property
    def identity(self) -> tuple[int, str]:
        """Index of the point with the name of the outlet."""
        return self.point.index, self.outlet.name

    @property
    def outlet_form(self) -> str | None:
        """Form of the outlet."""
        return self.outlet.form

    @property
    def orifice(self) -> float:
        """Width of the outlet [m]."""
        return self.outlet.width

    @property
    def label(self) -> str:
        """Name of the outlet, with the swept values."""
        return ", ".join(filter(None, (self.outlet.name, self.of_point.label)))

    def label_without(self, omitted) -> str:
        return ", ".join(filter(None, (self.outlet.name, self.of_point.label_without(omitted))))

    @property
    def flow_rate(self) -> Pooled | None:
        """Pooled W [kg/s] of the outlet; None if `outlets` was not measured, or no replicate gave one."""
        return self.pooled.get(FLOW_RATE + outlet_suffix(self.outlet))


def by_outlet(points: Sequence[PointResult]) -> tuple[PointResult, ...]:
    """Replace points that measured their outlets by these.

    Args:
        points: Points of a study.

    Returns:
        Points with one outlet as they are; of others each outlet of a known form, where `outlets` or `clogging` was
        measured.
    """
    return tuple(outlet_result for result in points for outlet_result in _outlets_of(result))


def _outlets_of(result: PointResult) -> Sequence[PointResult]:
    if isinstance(result, OutletResult):
        return (result,)
    outlets = result.point.scene.container.outlets
    measured = {name for run in result.runs for name in run.measures} & {OutletRates.name, Clogging.name}
    if len(outlets) < 2 or not measured:
        return (result,)
    own = {one.name: getattr(result, one.name) for one in fields(PointResult)}
    return [
        OutletResult(**own, whole=result, outlet_index=index)
        for index, outlet in enumerate(outlets)
        if outlet.form is not None and math.isfinite(outlet.width)
    ]
