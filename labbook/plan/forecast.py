"""How long a plan will take and how much disk it needs: estimates, and what they rest on."""

import math
from dataclasses import dataclass
from statistics import median

from labbook.catalogue.catalogue import Catalogue
from labbook.measure.expected import mass_flow
from labbook.plan.demand import Demand, PointDemand
from labbook.plan.plan import Plan
from labbook.plan.reach import PACKED, reach
from labbook.probes import Contacts, Probe, Sample, Zone
from labbook.protocol import placing

DEFAULT_SPEED = 5e6
"""Grain-steps per second and lane, where nothing was recorded on this machine yet."""
SETTLING = 2.0
"""Time that a filling takes to rest, in falls from the top of its start."""
_ROW = 8 * 14 * 0.75  # bytes of one crossing, compressed
_GRAIN = 400  # bytes of one grain's share of a checkpoint
_FRAME = 10.0  # bytes of one grain in one recorded frame, compressed
_FRAMES = 200
_NEAR, _CONTACTS = 30.0, 50.0  # bytes of one grain, and of its contacts, in one frame that is measured


@dataclass(frozen=True)
class Forecast:
    """Time [s] and disk [bytes] still needed; `basis` says what the speed rests on."""

    seconds: float
    disk: float
    grain_steps: float
    speed: float
    """Grain-steps per second of one lane."""
    lanes: int
    basis: str


def forecast(plan: Plan, catalogue: Catalogue, machine: str, device: str, lanes: int) -> Forecast:
    """Time and disk for what `plan` still has to do, on `lanes` lanes."""
    name = plan.engine.name
    recorded = [rate for _, rate in catalogue.speeds(name, machine, device)]
    speed = median(recorded) if recorded else DEFAULT_SPEED
    basis = (
        f"median of {len(recorded)} runs on this machine"
        if recorded
        else f"no run recorded on this machine yet: {DEFAULT_SPEED:.0e} grain-steps/s a lane assumed"
    )
    work = sum(discharge_work(item.demand.shared) for item in plan.todo)
    work += sum(fill_work(item.demand, catalogue) for item in plan.fillings.values())
    disk = sum(disk_of(item.demand) for item in plan.todo)
    disk += sum(100.0 * item.demand.point.scene.grains.count for item in plan.fillings.values())
    busy = max(1, min(lanes, len(plan.todo)))
    return Forecast(work / speed / busy, disk, work, speed, busy, basis)


def discharge_time(shared: PointDemand) -> float:
    """Expected simulated time [s] of a discharge: by Beverloo's law where there is a slot, else the longest
    allowed."""
    scene, stop = shared.scene, shared.stop
    flow = mass_flow(scene)
    if flow <= 0:
        return stop.max_time
    return min(stop.max_time, reach(shared) * scene.grains.count * scene.grains.mass / flow)


def discharge_work(shared: PointDemand) -> float:
    """Grain-steps of a discharge; grains that left cost nothing."""
    mean = shared.scene.grains.count * (1 - reach(shared) / 2)
    return mean * discharge_time(shared) / shared.numerics.dt


def fill_work(demand: Demand, catalogue: Catalogue | None = None) -> float:
    """Grain-steps of a filling, by the mean of recorded fillings of the same container if there are any."""
    known = catalogue.settling(demand.shared.closed_key) if catalogue else None
    return demand.shared.scene.grains.count * (known or fill_time(demand)) / demand.shared.numerics.dt


def fill_time(demand: Demand) -> float:
    """Expected simulated time [s] of a filling: a few falls from the height of its start."""
    scene, grains = demand.shared.scene, demand.shared.scene.grains
    container = scene.container
    wide = getattr(container, "width", getattr(container, "diameter", 10 * grains.diameter))
    deep = getattr(container, "thickness", getattr(container, "depth", wide))
    top = placing.volume_of_start(scene, demand.filling.kind) / (wide * deep)
    return min(demand.point.fill.max_time, SETTLING * math.sqrt(2 * top / scene.gravity))


def disk_of(demand: Demand) -> float:
    """Bytes that a run will keep."""
    count, there = demand.shared.scene.grains.count, reach(demand.shared)
    film = _FRAME * count * _FRAMES * (1 - there / 2) if demand.recorded else 0.0
    seen = sum(_bytes_of(probe, demand.shared) for probe in demand.shared.probes)
    return 5000 + count * (_ROW * there + _GRAIN) + film + seen


def _bytes_of(probe: Probe, shared: PointDemand) -> float:
    """What is kept of whole frames of grains and contacts, and of those around an outlet."""
    grains = shared.scene.grains
    if not isinstance(probe, Sample | Contacts | Zone):
        return 0.0
    frames = discharge_time(shared) / (probe.every * shared.numerics.beat)
    if isinstance(probe, Zone):
        around, above = probe.radius**2 * probe.high, probe.core**2 * (probe.top - probe.high)
        within = PACKED * math.pi * (around + above) / (math.pi / 6 * grains.equivalent_diameter**3)
        return _NEAR * within * frames * (2 if probe.again else 1)
    mean = grains.count * (1 - reach(shared) / 2)
    return mean * frames * (_NEAR if isinstance(probe, Sample) else _CONTACTS)
