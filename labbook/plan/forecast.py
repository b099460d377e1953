"""How long a plan will take and how much disk it needs: estimates, and what they rest on."""

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from statistics import median

from labbook.backend import Backend, Spec
from labbook.backend.machine import pace, wide_vectors
from labbook.backend.probes import Contacts, Probe, Sample, Traction, Zone
from labbook.filling import placing
from labbook.filling.bed import PACKED, bed_height_ahead
from labbook.lab.catalogue import Catalogue
from labbook.lab.records import RunRecord, Unreadable
from labbook.measure.expected import mass_flow
from labbook.plan.beds import mean_inside
from labbook.plan.demand import Demand, PointDemand
from labbook.plan.plan import Forecast, Plan
from labbook.plan.possible import specified
from labbook.scene import Scene
from labbook.scene.timescales import largest_stable_step
from labbook.scene.wall_bins import bins_of_walls

DEFAULT_SPEED = 5e6
"""Grain-steps per second and lane that are assumed of a backend that nothing is known of."""
CACHED = 50_000
"""Grains beyond which a scene is larger than a processor's caches."""
_BEYOND = 1.9
"""How much dearer a grain-step is there (docs/cpu-backend.md: 26.5 and 13.7 million a second)."""


@dataclass(frozen=True)
class StepCost:
    """Cost of one step of a lane: `step` [s] however few grains there are, and `grain` [s] for every grain; `compiling`
    [s]: before the first step of a set of features, unless its code is cached. `source`: where that was measured.
    `beat`: what each probe of a member costs the host at each beat [s], while the device waits."""

    step: float
    grain: float
    compiling: float
    source: str
    beat: float = 0.0

    def of(self, grains: float) -> float:
        """Cost of a grain-step [s] in a scene of so many grains."""
        return self.grain * (beyond_caches(grains) if self.step == 0 else 1.0)

    def at(self, speed: float) -> "StepCost":
        """The same on a processor of `speed` times that of the reference."""
        return replace(self, grain=self.grain / speed, compiling=self.compiling / speed)


def beyond_caches(grains: float) -> float:
    """How many times dearer a grain-step is on a processor in a scene of so many grains than in a small one."""
    return _BEYOND if grains > CACHED else 1.0


_ZEN4 = "one core of an AMD EPYC with AVX-512"
_ZEN3 = "one core of an AMD EPYC without AVX-512"
_H200 = "an NVIDIA H200"
_H200_COPIES = 4.0e12
"""Copy bandwidth of that device, read and written [bytes/s] (docs/gpu-backend.md)."""
_HOST = 1.5e-3  # 1 ms a beat with one probe (beside an H200) to 6 ms with three (beside an H100): docs/gpu-backend.md
MEASURED = {
    ("numba", "cpu", "sphere", "double", True): StepCost(0, 1 / 24e6, 9, _ZEN4),
    ("numba", "cpu", "sphere", "mixed", True): StepCost(0, 1 / 31e6, 9, _ZEN4),
    ("numba", "cpu", "spherocylinder", "double", True): StepCost(0, 1 / 8.2e6, 18, _ZEN4),
    ("numba", "cpu", "spherocylinder", "mixed", True): StepCost(0, 1 / 8.3e6, 18, _ZEN4),
    ("numba", "cpu", "sphere", "double", False): StepCost(0, 1 / 8.7e6, 20, _ZEN3),
    ("numba", "cpu", "sphere", "mixed", False): StepCost(0, 1 / 9.8e6, 20, _ZEN3),
    ("numba", "cpu", "spherocylinder", "double", False): StepCost(0, 1 / 3.5e6, 40, _ZEN3),
    ("numba", "cpu", "spherocylinder", "mixed", False): StepCost(0, 1 / 3.5e6, 40, _ZEN3),
    ("warp", "cuda", "sphere", "mixed", None): StepCost(5.0e-6, 1.35e-10, 4, _H200, _HOST),
    ("warp", "cuda", "sphere", "double", None): StepCost(5.0e-6, 2.7e-10, 4, _H200, _HOST),
    ("warp", "cuda", "spherocylinder", "mixed", None): StepCost(1.0e-5, 3.0e-10, 8, _H200, _HOST),
    ("warp", "cuda", "spherocylinder", "double", None): StepCost(1.0e-5, 5.9e-10, 8, _H200, _HOST),
}
"""By backend, kind of device, shape, precision and, of processors, whether they have vectors of 512 bits. From
benchmarks/results, docs/cpu-backend.md and docs/gpu-backend.md."""


def rate_of(backend: str, device: str, shape: str, precision: str) -> StepCost:
    """The measured cost of a step on `device` (`cpu`, `cuda:0`); DEFAULT_SPEED where nothing was measured."""
    kind = device.partition(":")[0]
    wide = wide_vectors() if kind == "cpu" else None
    return MEASURED.get((backend, kind, shape, precision, wide)) or StepCost(0, 1 / DEFAULT_SPEED, 0, "")


_NEVER: Mapping[str, float] = {}
SETTLING = 2.0
"""Time that a filling takes to rest, in falls from the top of its start."""
_AGAIN = 0.2
"""Part of that time which a bed takes to rest again after its walls have moved."""
HOLE = 0.6
"""Part of `mass_flow` that passes a round outlet: there C, 0.58, is that of the bulk density (Beverloo et al. 1961)."""
SCATTER = 1.3
"""Half width of the interval of W of a fed bed times the root of the grains that passed, relative to W
(docs/accuracy.md, outlets of 7 to 9 d)."""
_RECENT = 20
"""Runs of the same shape that a speed is the median of, at most."""
_ROW = 8 * 14 * 0.75  # bytes of one crossing, compressed
_GRAIN = 400  # bytes of one grain's share of a checkpoint
_FRAME, _TURNED = 23.0, 15.0  # bytes of one grain in one recorded frame, compressed; and of the orientation of a rod
_NEAR, _CONTACTS = 30.0, 50.0  # bytes of one grain, and of its contacts, in one frame that is measured
_SUMS = 50.0  # bytes of one bin of a wall in one frame


@dataclass
class _SpecCost:
    """What members of one Spec cost: grain-steps side by side, and steps of the longest."""

    grain_steps: float = 0.0
    cost: float = 0.0
    longest: float = 0.0
    rate: StepCost = field(default_factory=lambda: StepCost(0, 0, 0, ""))
    members: int = 0


def forecast(
    plan: Plan,
    catalogue: Catalogue,
    machine: str,
    device: str,
    lanes: int,
    backend: Backend | None = None,
    members: float = math.inf,
    measured: bool = True,
) -> Forecast:
    """Time and disk for what `plan` still has to do, on `lanes` lanes.

    Speeds are those of runs in this lab on this machine. Where there are none, they are those of a reference machine,
    scaled by what this machine gives at present, if `measured`: cores by `labbook.backend.machine.pace`, a GPU by the
    bandwidth that the backend measures.

    On a processor each lane computes one run. On other devices the runs of one set of features (of one Spec, if
    `backend` tells) go on side by side, `members` of them at once, and a step costs what starting it does beside what
    grains do. Compiling comes first, one set after another.
    """
    on_cpu = device.partition(":")[0] == "cpu"
    busy = max(1, min(lanes, len(plan.todo))) if on_cpu else 1
    speeds = _Speeds(catalogue, plan.backend.name, machine, device, busy, backend, measured)
    settled = catalogue.settling()
    specs = _Specs(backend)
    batches: dict[Spec | str, _SpecCost] = defaultdict(_SpecCost)
    chains: dict[str, float] = {}
    for item in plan.fillings.values():
        shared = item.demand.shared
        work = fill_work(item.demand, settled)
        steps = work / shared.scene.grains.count
        chains[item.keys.packing] = _add(batches[specs.filling(shared)], speeds.of(shared), work, steps, shared)
    longest = 0.0
    for item in plan.todo:
        shared = item.demand.shared
        work, steps = discharge_work(shared), outline(shared).steps
        probes = len(shared.probes) + item.demand.recorded
        cost = _add(batches[specs.discharge(shared)], speeds.of(shared), work, steps, shared, probes)
        longest = max(longest, cost + chains.get(item.keys.packing, 0.0))
    work = sum(batch.grain_steps for batch in batches.values())
    cost = sum(batch.cost for batch in batches.values())
    known = specs.known(plan) if backend is not None else set(batches)
    new = {key: batch for key, batch in batches.items() if key not in known and not specs.compiled(key, batch.rate)}
    compiling = sum(batch.rate.compiling for batch in new.values())
    if on_cpu:
        seconds = max(cost / busy, longest)
    else:
        waves = (math.ceil(batch.members / members) if members < math.inf else 1 for batch in batches.values())
        starts = sum(n * b.longest * b.rate.step for n, b in zip(waves, batches.values(), strict=True))
        seconds = cost + starts
    disk = sum(disk_of(item.demand) for item in plan.todo)
    disk += sum(100.0 * item.demand.point.scene.grains.count for item in plan.fillings.values())
    speed = work / cost if on_cpu and cost else work / seconds if seconds else 0.0
    return Forecast(seconds + compiling, disk, work, speed or DEFAULT_SPEED, busy, speeds.basis, compiling, len(new))


def _add(batch: _SpecCost, rate: StepCost, work: float, steps: float, shared: PointDemand, probes: int = 1) -> float:
    """Count a member in; what its grain-steps and beats cost [s]."""
    cost = work * rate.of(shared.scene.grains.count) + steps / shared.numerics.steps_per_beat * probes * rate.beat
    batch.grain_steps += work
    batch.cost += cost
    batch.longest = max(batch.longest, steps)
    batch.members += 1
    batch.rate = rate
    return cost


class _Specs:
    """The sets of features that runs need, as the backend tells them; without one, fillings and discharges are two."""

    def __init__(self, backend: Backend | None):
        self._backend = backend

    def filling(self, shared: PointDemand) -> Spec | str:
        return "filling" if self._backend is None else specified(self._backend, shared)[0]

    def discharge(self, shared: PointDemand) -> Spec | str:
        return "discharge" if self._backend is None else specified(self._backend, shared)[1]

    def compiled(self, spec: Spec | str, rate: StepCost) -> bool:
        """Tell if code is cached, of a lab without runs: there the backend is asked, which may take it a second."""
        return (
            bool(rate.source) and self._backend is not None and isinstance(spec, Spec) and self._backend.compiled(spec)
        )

    def known(self, plan: Plan) -> set[Spec | str]:
        """Those that runs which are done were computed with: their code is cached, if they ran here."""
        done = {item.demand.shared for item in plan.items if item.state == "done"}
        return {spec for shared in done for spec in (self.filling(shared), self.discharge(shared))}


class _Speeds:
    """Cost of a step: by runs of the same shape in this lab, else as measured when backends were made, scaled by the
    present speed of this machine."""

    def __init__(
        self,
        catalogue: Catalogue,
        name: str,
        machine: str,
        device: str,
        threads: int,
        backend: Backend | None,
        measured: bool,
    ):
        self._catalogue, self._name, self._machine, self._device = catalogue, name, machine, device
        self._threads, self._backend, self._measured = threads, backend, measured
        self._rates: dict[tuple[str, str], StepCost] = {}
        self._bases: dict[str, None] = {}
        self._by_shape: dict[str, list[float]] | None = None

    @property
    def basis(self) -> str:
        """Basis of the speeds, in words."""
        return "; ".join(self._bases) or "nothing to do"

    def of(self, shared: PointDemand) -> StepCost:
        shape, precision = shared.scene.grains.shape, shared.numerics.precision
        if (shape, precision) not in self._rates:
            self._rates[shape, precision] = self._find(shape, precision)
        return self._rates[shape, precision]

    def _find(self, shape: str, precision: str) -> StepCost:
        rate = rate_of(self._name, self._device, shape, precision)
        # on a GPU the speed of one run says little: others shared the device with it
        alone = self._device.partition(":")[0] == "cpu"
        recorded = self._recorded().get(shape, []) if alone else []
        if recorded:
            self._bases[f"median of {len(recorded)} runs on this machine"] = None
            return StepCost(0, 1 / median(recorded), rate.compiling, "")
        if rate.source:
            rate, basis = self._scaled(rate, alone)
        else:
            basis = f"{DEFAULT_SPEED:.0e} grain-steps/s per lane assumed"
        self._bases[f"{basis}, as this lab has no such run of this machine yet" if alone else basis] = None
        return rate

    def _scaled(self, rate: StepCost, on_cpu: bool) -> tuple[StepCost, str]:
        """The cost of a step of the reference machine on this one, and its basis in words."""
        basis = f"speed of {rate.source}"
        if on_cpu and self._measured:
            now = pace(self._threads)
            lane = f"each of {self._threads} lanes" if self._threads > 1 else "the lane"
            shares = f"a core is {now.core:.2g} times as fast, and {lane} gets {100 * now.share:.0f} % of one"
            return rate.at(now.core * now.share), f"{basis} times {now.core * now.share:.2g}, measured now: {shares}"
        copies = self._backend.bandwidth(self._device) if self._measured and self._backend is not None else None
        if copies is None:
            return rate, basis
        speed = copies / _H200_COPIES
        return replace(rate, grain=rate.grain / speed), f"{basis} times {speed:.2g}, measured now: its copy bandwidth"

    def _recorded(self) -> dict[str, list[float]]:
        """Grain-steps per second of the latest runs on this machine, by shape; of large scenes, what they would be in
        the processor's caches."""
        if self._by_shape is None:
            self._by_shape = defaultdict(list)
            for key, grains, rate in self._catalogue.speeds(self._name, self._machine, self._device):
                shape = self._shape(key)
                if shape is not None and len(self._by_shape[shape]) < _RECENT:
                    self._by_shape[shape].append(rate * beyond_caches(grains))
        return self._by_shape

    def _shape(self, key: str) -> str | None:
        try:
            return RunRecord.read(self._catalogue.lab.run(key)).scene.grains.shape
        except Unreadable:
            return None  # other verbs tell


def discharge_time(shared: PointDemand) -> float:
    """Expected simulated time [s] of a discharge: by Beverloo's law where there is an outlet, else the longest
    allowed."""
    bed, flow = shared.scene.grains.count * shared.scene.grains.mass, _flow(shared.scene)
    if flow <= 0:
        return shared.stop.max_time
    return min(shared.stop.max_time, _passing(shared) * bed / flow)


def _flow(scene: Scene) -> float:
    """Expected flow [kg/s]; 0 where none can be told."""
    return mass_flow(scene) * (HOLE if scene.container.outlet_form == "hole" else 1.0)


def _passing(shared: PointDemand) -> float:
    """Mass that leaves before a run ends, of that of the bed, if it is not out of time before."""
    precise = shared.stop.precise
    if precise is None:
        return shared.reach()
    return precise.start + (SCATTER / precise.flow_rate) ** 2 / shared.scene.grains.count


def _left(shared: PointDemand) -> float:
    """Mass that has left when a run ends, of that of the bed."""
    if not shared.stop.fed:
        return shared.reach()
    return discharge_time(shared) * _flow(shared.scene) / (shared.scene.grains.count * shared.scene.grains.mass)


def _inside(shared: PointDemand) -> float:
    """Grains inside, on average over a run."""
    return shared.scene.grains.count * (1.0 if shared.stop.fed else mean_inside(shared.reach()))


def discharge_work(shared: PointDemand) -> float:
    """Grain-steps of a discharge; grains that left cost nothing."""
    return _inside(shared) * outline(shared).steps


def fill_work(demand: Demand, settled: Mapping[str, float] = _NEVER) -> float:
    """Grain-steps of a filling; by the time that fillings of the same container took, where `settled` has it
    (`Catalogue.settling`)."""
    shared, known = demand.shared, settled.get(demand.shared.closed_key)
    return shared.scene.grains.count * (known / shared.filled_by.dt if known else outline(shared).fill_steps)


def fill_time(demand: Demand) -> float:
    """Expected simulated time [s] of a filling; of one that mobilises friction the bed then rests twice."""
    mobilise, settling = demand.point.fill.mobilise, settling_time(demand)
    return settling if mobilise is None else settling + mobilise.time + _AGAIN * settling


def settling_time(demand: Demand) -> float:
    """Expected simulated time [s] in which grains come to rest: a few falls from the height of their start."""
    scene = demand.shared.scene
    kind = demand.point.fill.kind
    top = placing.STARTS[kind].drop * placing.column(scene, kind)
    fall = math.sqrt(2 * top / scene.gravity) if scene.gravity > 0 else math.inf
    expected = demand.shared.pouring_time + SETTLING * fall
    until = demand.point.fill.until
    return min(demand.shared.longest_filling, expected if until is None else max(until, demand.shared.filled_by.beat))


def disk_of(demand: Demand) -> float:
    """Bytes that a run will keep."""
    count = demand.shared.scene.grains.count
    film = film_bytes(demand.shared) if demand.recorded else 0.0
    seen = sum(_bytes_of(probe, demand.shared) for probe in demand.shared.probes)
    return 5000 + count * (_ROW * _left(demand.shared) + _GRAIN) + film + seen


def film_bytes(shared: PointDemand) -> float:
    """Bytes of the recording of a run, if it is recorded."""
    if shared.film is None:
        return 0.0
    row = _FRAME + _TURNED * ("q" in shared.film.fields)
    return row * _inside(shared) * (discharge_time(shared) / shared.film.every + 1)


def _bytes_of(probe: Probe, shared: PointDemand) -> float:
    """What is kept of whole frames of grains and contacts, and of those around an outlet."""
    grains = shared.scene.grains
    if not isinstance(probe, Sample | Contacts | Zone | Traction):
        return 0.0
    frames = discharge_time(shared) / (probe.every * shared.numerics.beat)
    if isinstance(probe, Traction):
        bins = bins_of_walls(shared.scene, shared.scene.container.walls(), probe.size)
        return _SUMS * frames * sum(one.count for one in bins)
    if isinstance(probe, Zone):
        around, above = probe.radius**2 * probe.high, probe.core**2 * (probe.top - probe.high)
        within = PACKED * math.pi * (around + above) / (math.pi / 6 * grains.equivalent_diameter**3)
        return _NEAR * within * frames * (2 if probe.again else 1)
    return _inside(shared) * frames * (_NEAR if isinstance(probe, Sample) else _CONTACTS)


@dataclass(frozen=True, slots=True)
class Outline:
    """`dt` [s]; `limit` [s]: the largest step with which the beds of its flow and filling come to rest, as measured
    (`labbook.scene.timescales.largest_stable_step`); `fill_steps` and `steps`: of a filling and a discharge, as
    foreseen; `extent` [m]: the largest dimension of a grain; `ratio`: the orifice over it, None without one; `height`
    [m]: of the bed above the outlet or bottom at a packing fraction of PACKED, None where the container does not
    tell; `memory` [bytes] of one run."""

    dt: float
    limit: float
    fill_steps: float
    steps: float
    extent: float
    ratio: float | None
    height: float | None
    memory: float


BYTES = {"sphere": 800.0, "spherocylinder": 2200.0}
"""Memory that a grain takes at most on the CPU backend, while it is placed and while it moves with its near neighbours
and contacts. Measured: 435 with 200 000 spheres, 1800 with 50 000 rods; lists and checkpoints grow beyond that."""


def outline(shared: PointDemand) -> Outline:
    """What is foreseen of the runs of a point."""
    if shared.outline is None:
        shared.outline = _outlined(shared)
    return shared.outline


def _outlined(shared: PointDemand) -> Outline:
    scene, dt = shared.scene, shared.numerics.dt
    grains = scene.grains
    extent = grains.extent
    orifice = vars(scene.container).get("orifice")
    limit = largest_stable_step(scene.stiffened(shared.numerics.stiffness_scale))
    if shared.filled_by == shared.numerics:
        limit = min(limit, largest_stable_step(shared.closed.stiffened(shared.numerics.stiffness_scale)))
    return Outline(
        dt,
        limit,
        fill_time(shared.run(1)) / shared.filled_by.dt,
        discharge_time(shared) / dt,
        extent,
        None if orifice is None else orifice / extent,
        bed_height_ahead(scene),
        grains.count * BYTES[grains.shape],
    )
