"""Forecast of the wall time and disk space of a plan, with its basis."""

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from statistics import median

from labbook.backend import Backend, Spec
from labbook.backend.machine import pace, wide_vectors
from labbook.backend.probes import Contacts, Probe, Sample, Traction, Zone
from labbook.filling import placing
from labbook.filling.bed import PACKED, expected_bed_height
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
"""Speed that is assumed for an unknown backend [grain-steps/s, per worker]."""
CACHED = 50_000
"""Number of grains above which a scene exceeds a processor's caches."""
_CACHE_FACTOR = 1.9
"""Factor by which a grain-step costs more there (docs/cpu-backend.md: 26.5 and 13.7 million a second)."""


@dataclass(frozen=True)
class StepCost:
    """Cost of one step of a worker.

    Args:
        step: Cost of starting a step [s].
        grain: Cost of each grain [s].
        compiling: Time before the first step of a Spec, unless its code is cached [s].
        source: Machine on which it was measured.
        beat: Cost of each probe of a member at each beat, while the device waits [s].
    """

    step: float
    grain: float
    compiling: float
    source: str
    beat: float = 0.0

    def of(self, grains: float) -> float:
        """Cost of a grain-step [s] in a scene of `grains` grains."""
        return self.grain * (beyond_caches(grains) if self.step == 0 else 1.0)

    def at(self, speed: float) -> "StepCost":
        """Return the cost on a processor of `speed` times the reference's speed."""
        return replace(self, grain=self.grain / speed, compiling=self.compiling / speed)


def beyond_caches(grains: float) -> float:
    """Factor by which a grain-step costs more in a scene of `grains` grains than in a small one, on a processor."""
    return _CACHE_FACTOR if grains > CACHED else 1.0


_ZEN4 = "one core of an AMD EPYC with AVX-512"
_ZEN3 = "one core of an AMD EPYC without AVX-512"
_H200 = "an NVIDIA H200"
_H100 = "an NVIDIA H100"
_H200_COPIES = 4.0e12
"""Copy bandwidth of that device, reads plus writes [bytes/s] (docs/gpu-backend.md)."""
_HOST = 1.5e-3  # 1 ms a beat with one probe (beside an H200) to 6 ms with three (beside an H100): docs/gpu-backend.md
MEASURED = {
    ("numba", "cpu", "sphere", "double", True): StepCost(0, 1 / 24e6, 9, _ZEN4),
    ("numba", "cpu", "sphere", "mixed", True): StepCost(0, 1 / 31e6, 9, _ZEN4),
    ("numba", "cpu", "spherocylinder", "double", True): StepCost(0, 1 / 8.2e6, 18, _ZEN4),
    ("numba", "cpu", "spherocylinder", "mixed", True): StepCost(0, 1 / 8.3e6, 18, _ZEN4),
    # of three spheres
    ("numba", "cpu", "clump", "double", True): StepCost(0, 1 / 4.4e6, 14, _ZEN4),
    ("numba", "cpu", "clump", "mixed", True): StepCost(0, 1 / 4.6e6, 14, _ZEN4),
    ("numba", "cpu", "sphere", "double", False): StepCost(0, 1 / 8.7e6, 20, _ZEN3),
    ("numba", "cpu", "sphere", "mixed", False): StepCost(0, 1 / 9.8e6, 20, _ZEN3),
    ("numba", "cpu", "spherocylinder", "double", False): StepCost(0, 1 / 3.5e6, 40, _ZEN3),
    ("numba", "cpu", "spherocylinder", "mixed", False): StepCost(0, 1 / 3.5e6, 40, _ZEN3),
    ("warp", "cuda", "sphere", "mixed", None): StepCost(5.0e-6, 1.35e-10, 4, _H200, _HOST),
    ("warp", "cuda", "sphere", "double", None): StepCost(5.0e-6, 2.7e-10, 4, _H200, _HOST),
    ("warp", "cuda", "spherocylinder", "mixed", None): StepCost(1.0e-5, 3.0e-10, 8, _H200, _HOST),
    ("warp", "cuda", "spherocylinder", "double", None): StepCost(1.0e-5, 5.9e-10, 8, _H200, _HOST),
    # of three spheres; in double no speed was measured, and that of spheres and rods is half of the other
    ("warp", "cuda", "clump", "mixed", None): StepCost(1.0e-5, 1.0e-9, 8, _H100, _HOST),
    ("warp", "cuda", "clump", "double", None): StepCost(1.0e-5, 2.0e-9, 8, _H100, _HOST),
}
"""Measured costs by backend, kind of device, shape, precision and, for processors, vectors of 512 bits.

From benchmarks/results, docs/cpu-backend.md and docs/gpu-backend.md.
"""


def rate_of(backend: str, device: str, shape: str, precision: str) -> StepCost:
    """Return the measured cost of a step on `device` (`cpu`, `cuda:0`); that of DEFAULT_SPEED where nothing was
    measured."""
    kind = device.partition(":")[0]
    wide = wide_vectors() if kind == "cpu" else None
    return MEASURED.get((backend, kind, shape, precision, wide)) or StepCost(0, 1 / DEFAULT_SPEED, 0, "")


_NO_TIMES: Mapping[str, float] = {}
SETTLING = 2.0
"""Time of a filling until rest, in falls from the top of its start."""
_RESETTLING = 0.2
"""Time to rest again after walls have moved, as a fraction of that."""
HOLE = 0.6
"""Fraction of `mass_flow` that passes a round outlet: there C = 0.58 belongs to the bulk density (Beverloo et al.
1961)."""
SCATTER = 1.3
"""Relative half width of the interval of W of a fed bed, times the root of the number of grains that passed.

From docs/accuracy.md, outlets of 7 to 9 d.
"""
_MAX_RECENT = 20
"""Maximum number of runs of the same shape over which a speed is the median."""
_CROSSING = 8 * 14 * 0.75  # bytes of one crossing, compressed
_GRAIN = 400  # bytes of one grain's share of a checkpoint
_FRAME, _TURNED = 23.0, 15.0  # bytes of one grain in one recorded frame, compressed; and of the orientation of a rod
_GRAIN_FRAME, _CONTACTS = 30.0, 50.0  # bytes of one grain, and of its contacts, in one frame that is measured
_SUMS = 50.0  # bytes of one bin of a wall in one frame


@dataclass
class _SpecCost:
    """Cost of the members of one Spec: total grain-steps, and steps of the longest member."""

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
    workers: int,
    backend: Backend | None = None,
    members: float = math.inf,
    measured: bool = True,
) -> Forecast:
    """Forecast wall time and disk for what a plan lacks.

    Speeds are those of runs in this lab on this machine. Without any, they are those of a reference machine, scaled by
    the present speed of this one: cores by `labbook.backend.machine.pace`, a GPU by its bandwidth.

    On a processor each worker computes one run. On other devices the members of one Spec are stepped together, and a
    step costs its start plus its grains. Compiling comes first, one Spec after another.

    Args:
        plan: The plan.
        catalogue: Index of the lab.
        machine: Processor and device, as in the provenance of runs.
        device: Device.
        workers: Number of workers.
        backend: Backend that gives Specs and bandwidth; None: unknown.
        members: Maximum number of members at once.
        measured: Measure the present speed of this machine.
    """
    on_cpu = device.partition(":")[0] == "cpu"
    busy = max(1, min(workers, len(plan.todo))) if on_cpu else 1
    speeds = _Speeds(catalogue, plan.backend.name, machine, device, busy, backend, measured)
    fill_times = catalogue.settling()
    specs = _Specs(backend)
    batches: dict[Spec | str, _SpecCost] = defaultdict(_SpecCost)
    chains: dict[str, float] = {}
    for item in plan.fillings.values():
        shared = item.demand.shared
        work = fill_work(item.demand, fill_times)
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
    cached = specs.computed_specs(plan) if backend is not None else set(batches)
    uncached = {
        key: batch for key, batch in batches.items() if key not in cached and not specs.compiled(key, batch.rate)
    }
    compiling = sum(batch.rate.compiling for batch in uncached.values())
    if on_cpu:
        # Work spread evenly over workers, but never less than the longest filling followed by its discharge.
        seconds = max(cost / busy, longest)
    else:
        waves = (math.ceil(batch.members / members) if members < math.inf else 1 for batch in batches.values())
        starts = sum(n * b.longest * b.rate.step for n, b in zip(waves, batches.values(), strict=True))
        seconds = cost + starts
    disk = sum(disk_of(item.demand) for item in plan.todo)
    disk += sum(100.0 * item.demand.point.scene.grains.count for item in plan.fillings.values())
    speed = work / cost if on_cpu and cost else work / seconds if seconds else 0.0
    return Forecast(
        seconds + compiling, disk, work, speed or DEFAULT_SPEED, busy, speeds.basis, compiling, len(uncached)
    )


def _add(batch: _SpecCost, rate: StepCost, work: float, steps: float, shared: PointDemand, probes: int = 1) -> float:
    """Add a member to the cost of its Spec; return its own cost [s]."""
    cost = work * rate.of(shared.scene.grains.count) + steps / shared.numerics.steps_per_beat * probes * rate.beat
    batch.grain_steps += work
    batch.cost += cost
    batch.longest = max(batch.longest, steps)
    batch.members += 1
    batch.rate = rate
    return cost


class _Specs:
    """Specs of runs; without a backend fillings and discharges count as two."""

    def __init__(self, backend: Backend | None):
        self._backend = backend

    def filling(self, shared: PointDemand) -> Spec | str:
        """Spec of the filling of a point."""
        return "filling" if self._backend is None else specified(self._backend, shared)[0]

    def discharge(self, shared: PointDemand) -> Spec | str:
        """Spec of the discharge of a point."""
        return "discharge" if self._backend is None else specified(self._backend, shared)[1]

    def compiled(self, spec: Spec | str, rate: StepCost) -> bool:
        """Decide whether code is cached, in a lab without runs: asking the backend may take a second."""
        return (
            bool(rate.source) and self._backend is not None and isinstance(spec, Spec) and self._backend.compiled(spec)
        )

    def computed_specs(self, plan: Plan) -> set[Spec | str]:
        """Specs of finished runs: their code is cached, if they ran on this machine."""
        done = {item.demand.shared for item in plan.items if item.state == "done"}
        return {spec for shared in done for spec in (self.filling(shared), self.discharge(shared))}


class _Speeds:
    """Costs of steps: from runs of the same shape in this lab, else measured reference costs scaled to this machine."""

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
        """Cost of a step of a point's runs."""
        shape, precision = shared.scene.grains.shape, shared.numerics.precision
        if (shape, precision) not in self._rates:
            self._rates[shape, precision] = self._find(shape, precision)
        return self._rates[shape, precision]

    def _find(self, shape: str, precision: str) -> StepCost:
        rate = rate_of(self._name, self._device, shape, precision)
        # on a GPU the speed of one run says little: others shared the device with it
        on_cpu = self._device.partition(":")[0] == "cpu"
        recorded = self._recorded().get(shape, []) if on_cpu else []
        if recorded:
            self._bases[f"median of {len(recorded)} runs on this machine"] = None
            return StepCost(0, 1 / median(recorded), rate.compiling, "")
        if rate.source:
            rate, basis = self._scaled(rate, on_cpu)
        else:
            basis = f"{DEFAULT_SPEED:.0e} grain-steps/s per worker assumed"
        self._bases[f"{basis}, as this lab has no such run of this machine yet" if on_cpu else basis] = None
        return rate

    def _scaled(self, rate: StepCost, on_cpu: bool) -> tuple[StepCost, str]:
        """Scale the cost of the reference machine to this one; return it with its basis in words."""
        basis = f"speed of {rate.source}"
        if on_cpu and self._measured:
            current = pace(self._threads)
            worker = f"each of {self._threads} workers" if self._threads > 1 else "the worker"
            shares = f"a core is {current.core:.2g} times as fast, and {worker} gets {100 * current.share:.0f} % of one"
            return rate.at(
                current.core * current.share
            ), f"{basis} times {current.core * current.share:.2g}, measured now: {shares}"
        copies = self._backend.bandwidth(self._device) if self._measured and self._backend is not None else None
        if copies is None:
            return rate, basis
        speed = copies / _H200_COPIES
        return replace(rate, grain=rate.grain / speed), f"{basis} times {speed:.2g}, measured now: its copy bandwidth"

    def _recorded(self) -> dict[str, list[float]]:
        """Speeds of the latest runs on this machine, by shape [grain-steps/s]; large scenes are converted to scenes in
        caches."""
        if self._by_shape is None:
            self._by_shape = defaultdict(list)
            for key, grains, rate in self._catalogue.speeds(self._name, self._machine, self._device):
                shape = self._shape(key)
                if shape is not None and len(self._by_shape[shape]) < _MAX_RECENT:
                    self._by_shape[shape].append(rate * beyond_caches(grains))
        return self._by_shape

    def _shape(self, key: str) -> str | None:
        """Shape of grains of a run; None if its record is unreadable."""
        try:
            return RunRecord.read(self._catalogue.lab.run(key)).scene.grains.shape
        except Unreadable:
            return None  # other verbs tell


def discharge_time(shared: PointDemand) -> float:
    """Expected simulated time of a discharge [s]: by Beverloo's law, or the maximum time if there is no outlet."""
    bed, flow = shared.scene.grains.count * shared.scene.grains.mass, _flow(shared.scene)
    if flow <= 0:
        return shared.stop.max_time
    return min(shared.stop.max_time, _passing_fraction(shared) * bed / flow)


def _flow(scene: Scene) -> float:
    """Expected flow [kg/s]; 0 if it cannot be forecast."""
    return mass_flow(scene) * (HOLE if scene.container.outlet_form == "hole" else 1.0)


def _passing_fraction(shared: PointDemand) -> float:
    """Mass that leaves before a run ends, relative to that of the bed, if time does not end it."""
    precise = shared.stop.precise
    if precise is None:
        return shared.reach()
    return precise.start + (SCATTER / precise.flow_rate) ** 2 / shared.scene.grains.count


def _discharged_fraction(shared: PointDemand) -> float:
    """Mass that has left when a run ends, relative to that of the bed."""
    if not shared.stop.fed:
        return shared.reach()
    return discharge_time(shared) * _flow(shared.scene) / (shared.scene.grains.count * shared.scene.grains.mass)


def _mean_grains(shared: PointDemand) -> float:
    """Mean number of grains inside during a run."""
    return shared.scene.grains.count * (1.0 if shared.stop.fed else mean_inside(shared.reach()))


def discharge_work(shared: PointDemand) -> float:
    """Grain-steps of a discharge; grains that have left cost nothing."""
    return _mean_grains(shared) * outline(shared).steps


def fill_work(demand: Demand, fill_times: Mapping[str, float] = _NO_TIMES) -> float:
    """Grain-steps of a filling, by the mean duration `fill_times` of earlier fillings of the container where there are
    any."""
    shared, duration = demand.shared, fill_times.get(demand.shared.closed_key)
    return shared.scene.grains.count * (
        duration / shared.filling_numerics.dt if duration else outline(shared).fill_steps
    )


def fill_time(demand: Demand) -> float:
    """Expected simulated time of a filling [s]; one that mobilises friction rests twice."""
    mobilise, settling = demand.point.fill.mobilise, settling_time(demand)
    return settling if mobilise is None else settling + mobilise.time + _RESETTLING * settling


def settling_time(demand: Demand) -> float:
    """Expected simulated time until grains come to rest [s]: a few falls from the height of their start."""
    scene = demand.shared.scene
    kind = demand.point.fill.kind
    top = placing.STARTS[kind].drop * placing.column(scene, kind)
    fall = math.sqrt(2 * top / scene.gravity) if scene.gravity > 0 else math.inf
    expected = demand.shared.pouring_time + SETTLING * fall
    until = demand.point.fill.until
    return min(
        demand.shared.longest_filling, expected if until is None else max(until, demand.shared.filling_numerics.beat)
    )


def disk_of(demand: Demand) -> float:
    """Disk space of a run [bytes]."""
    count = demand.shared.scene.grains.count
    film = film_bytes(demand.shared) if demand.recorded else 0.0
    observed = sum(_bytes_of(probe, demand.shared) for probe in demand.shared.probes)
    return 5000 + count * (_CROSSING * _discharged_fraction(demand.shared) + _GRAIN) + film + observed


def film_bytes(shared: PointDemand) -> float:
    """Disk space of the recording of a run, if it is recorded [bytes]."""
    if shared.film is None:
        return 0.0
    row = _FRAME + _TURNED * ("q" in shared.film.fields)
    return row * _mean_grains(shared) * (discharge_time(shared) / shared.film.every + 1)


def _bytes_of(probe: Probe, shared: PointDemand) -> float:
    """Disk space of the frames of a probe [bytes]."""
    grains = shared.scene.grains
    if not isinstance(probe, Sample | Contacts | Zone | Traction):
        return 0.0
    frames = discharge_time(shared) / (probe.every * shared.numerics.beat)
    if isinstance(probe, Traction):
        bins = bins_of_walls(shared.scene, shared.scene.container.walls(), probe.size)
        return _SUMS * frames * sum(bins_of_wall.count for bins_of_wall in bins)
    if isinstance(probe, Zone):
        around, above = probe.radius**2 * probe.high, probe.core**2 * (probe.top - probe.high)
        within = PACKED * math.pi * (around + above) / (math.pi / 6 * grains.equivalent_diameter**3)
        return _GRAIN_FRAME * within * frames * (2 if probe.again else 1)
    return _mean_grains(shared) * frames * (_GRAIN_FRAME if isinstance(probe, Sample) else _CONTACTS)


@dataclass(frozen=True, slots=True)
class Outline:
    """Forecast numbers of the runs of a point.

    Args:
        dt: Time step [s].
        limit: Largest time step with which its beds come to rest, as measured [s]
            (`labbook.scene.timescales.largest_stable_step`).
        fill_steps: Steps of a filling.
        steps: Steps of a discharge.
        extent: Largest dimension of a grain [m].
        ratio: Orifice over `extent`; None without an orifice.
        height: Height of the bed above outlet or bottom at a packing fraction of PACKED [m]; None if it is unknown.
        memory: Memory of one run [bytes].
    """

    dt: float
    limit: float
    fill_steps: float
    steps: float
    extent: float
    ratio: float | None
    height: float | None
    memory: float


BYTES = {"sphere": 800.0, "spherocylinder": 2200.0, "clump": 8000.0}
"""Maximum memory of a grain on the CPU backend, during placing and motion [bytes].

Measured: 435 with 200 000 spheres, 1800 with 50 000 rods; lists and checkpoints grow beyond that. That of clumps is a
guess.
"""


def outline(shared: PointDemand) -> Outline:
    """Return the forecast numbers of the runs of a point, computed once."""
    if shared.outline is None:
        shared.outline = _make_outline(shared)
    return shared.outline


def _make_outline(shared: PointDemand) -> Outline:
    scene, dt = shared.scene, shared.numerics.dt
    grains = scene.grains
    extent = grains.extent
    orifice = vars(scene.container).get("orifice")
    limit = largest_stable_step(scene.stiffened(shared.numerics.stiffness_scale))
    if shared.filling_numerics == shared.numerics:
        limit = min(limit, largest_stable_step(shared.closed.stiffened(shared.numerics.stiffness_scale)))
    return Outline(
        dt,
        limit,
        fill_time(shared.run(1)) / shared.filling_numerics.dt,
        discharge_time(shared) / dt,
        extent,
        None if orifice is None else orifice / extent,
        expected_bed_height(scene),
        grains.count * BYTES[grains.shape],
    )
