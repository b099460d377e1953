"""Facts on a run that clogged: time, outlet in grain diameters, other seeds, and the next wider outlet that flows."""

from dataclasses import dataclass

from labbook.lab import LabError, RunRecord
from labbook.measure.arch import Arch
from labbook.measure.clogging import width_ratio
from labbook.results import display
from labbook.results.points import FLOW_RATE, ORIFICE, PointResult
from labbook.study import StudyError
from labbook_web.pages.sheet import with_unit
from labbook_web.store import LabStore, NotFound


@dataclass(frozen=True)
class FlowingPoint:
    """The point with the next wider outlet, all else equal, at which no run clogged."""

    point: int
    label: str
    text: str


@dataclass(frozen=True)
class Clogged:
    """Facts of a run that clogged.

    Attributes:
        rows: Terms and sentences.
        flowing: Next wider outlet at which all runs flowed; None without any.
        arch: The run measured the arch.
    """

    rows: tuple[tuple[str, str], ...]
    flowing: FlowingPoint | None
    arch: bool


def clogged(store: LabStore, record: RunRecord) -> Clogged | None:
    """Sum up why a run clogged; None of a run that did not."""
    if record.outcome != "clogged":
        return None
    coverage, container = record.coverage, record.scene.container
    last = coverage.duration - coverage.waiting
    rows = [("When", f"after {coverage.crossed} of {coverage.grains} grains; the last left at t = {last:.3g} s")]
    if len(container.outlets) == 1:
        width = f"{container.outlets[0].width * 1e3:.4g} mm"
        rows.append(("Outlet", f"D = {width} = {width_ratio(record.scene):.3g} grain diameters"))
    result, points = _point(store, record)
    flowing = None
    if result is not None:
        stopped = result.outcomes["clogged"]
        rows.append(("This point", f"{stopped} of {len(result.runs)} runs clogged"))
        flowing = _flowing(result, points)
        if flowing is None and ORIFICE in result.at:
            rows.append(("Wider outlets", "no wider outlet of this study flowed in all runs, all else equal"))
    return Clogged(tuple(rows), flowing, Arch.name in record.observe.measure)


def _point(store: LabStore, record: RunRecord) -> tuple[PointResult | None, tuple[PointResult, ...]]:
    """Find the point of a run, and all points of its study; None and no points if the lab lacks its file."""
    try:
        points = store.contents(record.study, record.backend).results.points
    except (NotFound, StudyError, LabError, ValueError):
        return None, ()
    return next((one for one in points if any(run.run_key == record.run_key for run in one.runs)), None), points


def _flowing(result: PointResult, points: tuple[PointResult, ...]) -> FlowingPoint | None:
    rest = {name: value for name, value in result.at.items() if name != ORIFICE}
    wider = [
        candidate
        for candidate in points
        if candidate.orifice > result.orifice
        and not candidate.outcomes["clogged"]
        and {name: value for name, value in candidate.at.items() if name != ORIFICE} == rest
    ]
    if not wider:
        return None
    nearest = min(wider, key=lambda candidate: candidate.orifice)
    unit, flow = display.quantity(FLOW_RATE), nearest.flow_rate
    text = f"D = {nearest.orifice * 1e3:.4g} mm = {width_ratio(nearest.point.scene):.3g} grain diameters"
    if flow is not None:
        text += f": {unit.name} = {with_unit(flow, unit)}"
    return FlowingPoint(nearest.point.index + 1, nearest.label, text)
