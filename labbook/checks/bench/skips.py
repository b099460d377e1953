"""What a backend saves by leaving out what a scene does not need, and that leaving it out changes nothing.

Each thing that is left out is put back, one after another: features of the compiled kernels, lists of neighbours that
are kept while no grain has moved far, and frames that nobody asked for. Both ways go on from one bed of Fan's hopper;
they are timed in turns, and their states after a while are compared. On a processor one scene is timed, by processor
time; on a GPU, which one small scene does not fill, 64 of them side by side, by the clock. What a dense start saves of
a filling, the fall of the grains, is counted in steps; its beds are others (benchmarks/filling.py compares them).
"""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from labbook.backend import Backend, Ensemble, Failed, Settled, Spec, Unsupported, load
from labbook.backend.machine import hardware
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Probe, Sample, Traction
from labbook.checks.bench.speed import FAN_STEP, SETTLED, fan, on_one_thread, settled
from labbook.filling.placing import STARTS, place
from labbook.scene import Scene, TriangleMesh, Wall
from labbook.scene.packing import Packing
from labbook.scene.triangles import Triangles

GRAINS = 1500
STEPS_PER_BEAT = 200
COMPARED = 2
"""Beats after which the states are compared: before a difference of one rounding has grown."""
TIMED = 10
"""Beats of one timing."""
ON_GPU = 64
"""Scenes that are timed together on a GPU."""


@dataclass(frozen=True)
class Skip:
    """What is left out, and how it is put back.

    `scene`: the scene that does not need it, from Fan's closed hopper. `features`: of the kernels, that are compiled in
    all the same; `walls`: whether walls of all kinds are, too. `numerics`, `probes`: changed and added ones. `falling`:
    whether it is measured while the grains fall, and not at rest.
    """

    name: str
    scene: Callable[[Scene], Scene] = lambda scene: scene
    features: Mapping[str, object] = field(default_factory=dict)
    walls: bool = False
    numerics: Mapping[str, object] = field(default_factory=dict)
    probes: tuple[Probe, ...] = ()
    falling: bool = False

    def spec(self, backend: Backend, scene: Scene, numerics: Numerics) -> Spec:
        """What is compiled where nothing is left out."""
        made = backend.specialise(scene, numerics, self.probes)
        known = dict(made.features)
        if unknown := self.features.keys() - known.keys():
            raise ValueError(f"the backend {made.backend} has no features {', '.join(sorted(unknown))}")
        known |= self.features
        if self.walls:
            # those of triangles take other memory
            known["walls"] = tuple(sorted(backend.capabilities.walls - {TriangleMesh.model_fields["kind"].default}))
        return replace(made, features=tuple(sorted(known.items())))


def _law(**changes: object) -> Callable[[Scene], Scene]:
    return lambda scene: scene.model_copy(update={"contact": scene.contact.model_copy(update=changes)})


def _over_a_sheet(scene: Scene) -> Scene:
    """The scene with a sheet of triangles at rest on its bottom."""
    (left, front, _), (right, back, _) = scene.container.bounds.low, scene.container.bounds.high
    ends = np.array([(x, y, 0.0) for x in (left, right) for y in (front, back)])
    surface, _ = Triangles.welded(ends, np.array([[0, 1, 2], [1, 2, 3]]))
    sheet = Wall(name="sheet", shape=TriangleMesh.of_surface(surface))
    return scene.model_copy(update={"container": scene.container.model_copy(update={"parts": (sheet,)})})


SKIPS = (
    Skip("kinds of walls that are not there", walls=True),
    Skip("friction", _law(friction=0.0, rolling_friction=0.0), {"FRICTION": True}),
    Skip("rolling resistance", _law(rolling_friction=0.0), {"ROLLING": True, "TWIST": True}),
    Skip("walls that move", features={"MOVING": True}),
    Skip("parts that move", _over_a_sheet, {"MOVING": True, "POSES": True}),
    Skip("an outlet", features={"OUTLET": True}),
    Skip("crossings of a plane", features={"CROSSING": True}),
    Skip("energies", features={"LEDGER": True}),
    Skip("new lists of neighbours five times as often", numerics={"skin": 0.03}, falling=True),
    Skip("forces of walls at every beat", probes=(Traction(size=6e-3),)),
    Skip("frames of all grains at every beat", probes=(Sample(fields=("x", "v", "omega")),)),
    Skip("contacts of the bed at every beat, as arches need them", probes=(Sample(fields=("x",)), Contacts())),
)


@dataclass(frozen=True)
class SkipSaving:
    """What one skip saves: time with it put back over time without, median and range over rounds.

    `same`: whether both states are the same in every bit, after COMPARED beats; `difference`: the largest one of
    positions, in diameters.
    """

    name: str
    times: float
    low: float
    high: float
    same: bool
    difference: float


@dataclass(frozen=True)
class SkipsBench:
    """What the skips of one backend save on this machine: in `scenes` side by side, of `grains` each."""

    backend: str
    device: str
    precision: str
    hardware: dict[str, object]
    scenes: int
    grains: int
    saved: tuple[SkipSaving, ...]
    fall: float
    """Steps of a filling from a rain over those from a dense start, until each rests by its own rule."""

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return asdict(self)


def run(
    name: str = "numba",
    repeats: int = 5,
    device: str = "cpu",
    precision: str = "double",
    say: Callable[[str], None] = lambda _: None,
    skips: Sequence[Skip] = SKIPS,
    grains: int = GRAINS,
) -> SkipsBench:
    """Measure the backend called `name`, on one thread where it has a choice; `say` tells of skips that need what it
    lacks. Raises BackendMissing."""
    whole = load(name)
    backend = on_one_thread(whole) or whole
    closed = fan(grains=grains).close()
    say(f"settling {grains} grains (compiles)")
    bed = settled(load("numba"), closed, FAN_STEP, SETTLED)
    numerics = FAN_STEP.model_copy(update={"steps_per_beat": STEPS_PER_BEAT, "precision": precision})
    say("filling from a rain and from a dense start")
    falls = [steps_to_rest(backend, device, closed, numerics, kind) for kind in ("rain", "dense")]
    saved = []
    for skip in skips:
        say(f"putting back {skip.name} (compiles)")
        start = place(closed, "gas", 1) if skip.falling else bed
        try:
            saved.append(measured(skip, backend, device, skip.scene(closed), numerics, start, repeats))
        except Unsupported as error:
            say(f"without {skip.name}: {error}")
    return SkipsBench(
        name, device, precision, hardware(), side_by_side(device), grains, tuple(saved), falls[0] / falls[1]
    )


def measured(
    skip: Skip, backend: Backend, device: str, scene: Scene, numerics: Numerics, start: Packing, repeats: int
) -> SkipSaving:
    """What `skip` saves in `scene`, from `start` on."""
    more = numerics.model_copy(update=dict(skip.numerics))
    members = side_by_side(device)
    clock = time.process_time if members == 1 else time.perf_counter
    plain = backend.open(backend.specialise(scene, numerics), members, device)
    whole = backend.open(skip.spec(backend, scene, more), members, device)
    ends: list[Packing] = []
    for ensemble, how in ((plain, numerics), (whole, more)):
        admitted = [ensemble.admit(scene, how, start) for _ in range(members)]
        _advance(ensemble, COMPARED, skip.name)
        ends.append(ensemble.packing(admitted[0]))
    spent: tuple[list[float], list[float]] = ([], [])
    for _ in range(repeats):
        for ensemble, times in zip((plain, whole), spent, strict=True):
            began = clock()
            _advance(ensemble, TIMED, skip.name)
            times.append(clock() - began)
    plain.close()
    whole.close()
    ratios = [slow / fast for fast, slow in zip(*spent, strict=True)]
    one, other = ends
    same = all(np.array_equal(getattr(one, key), getattr(other, key)) for key in ("x", "v", "omega"))
    difference = float(np.abs(one.x - other.x).max()) / scene.grains.diameter
    return SkipSaving(skip.name, statistics.median(ratios), min(ratios), max(ratios), same, difference)


def steps_to_rest(backend: Backend, device: str, closed: Scene, numerics: Numerics, kind: str) -> int:
    """Steps of a filling from the start called `kind`, until it rests."""
    start = STARTS[kind]
    ensemble = backend.open(backend.specialise(closed, numerics), 1, device)
    member = ensemble.admit(
        closed,
        numerics,
        place(closed, kind, 1),
        settled_below=start.settled_below,
        settled_beats=start.quiet_beats(closed, numerics.beat),
    )
    while not (events := ensemble.advance(1)):
        pass
    steps = ensemble.status(member).step
    ensemble.close()
    if not isinstance(events[0], Settled):
        raise RuntimeError(f"a bed from a {kind} does not come to rest: {events[0]}")
    return steps


def side_by_side(device: str) -> int:
    """Scenes that are timed together on `device`."""
    return 1 if device == "cpu" else ON_GPU


def _advance(ensemble: Ensemble, beats: int, name: str) -> None:
    """Beat by beat, as runs do it: rows are fetched after each."""
    for _ in range(beats):
        events: Sequence[Any] = ensemble.advance(1)
        if failed := [event for event in events if isinstance(event, Failed)]:
            raise RuntimeError(f"{name}: {failed[0].message}")
        ensemble.drain()
