"""Measurement of the work that a backend skips where a scene does not need it, and of the equality of the results.

Each skip is undone in turn: features of the compiled kernels, neighbour lists that are reused while no grain has moved
far, and frames that no probe requests. Both variants go on from one bed of Fan's hopper. They are timed in alternation,
and their states are compared. On a CPU one scene is timed, by processor time. One small scene does not fill a GPU, so
there 64 of them are timed side by side, by the wall clock. A dense start saves the fall of the grains; that saving is
counted in steps, and its beds differ from those of a rain (benchmarks/filling.py compares them).
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
from labbook.checks.bench.speed import FAN_STEP, SETTLED, fan, on_one_thread, settle
from labbook.filling.placing import STARTS, place
from labbook.scene import Clumps, Scene, TriangleMesh, Wall
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
    """Work that a backend leaves out, with the change that adds it again.

    Args:
        name: Name in reports.
        scene: Makes the scene that does not need the work from Fan's closed hopper.
        features: Features of the kernels to compile in all the same.
        walls: Compile in all kinds of walls.
        numerics: Numerical parameters to change.
        probes: Probes to add.
        falling: Measure while the grains fall, not at rest.
        restored: Makes the scene that needs the work for the same motion, where no feature of the kernels adds it.
    """

    name: str
    scene: Callable[[Scene], Scene] = lambda scene: scene
    features: Mapping[str, object] = field(default_factory=dict)
    walls: bool = False
    numerics: Mapping[str, object] = field(default_factory=dict)
    probes: tuple[Probe, ...] = ()
    falling: bool = False
    restored: Callable[[Scene], Scene] = lambda scene: scene

    def spec(self, backend: Backend, scene: Scene, numerics: Numerics) -> Spec:
        """Return the Spec of kernels that leave nothing out. Raises ValueError for a feature that does not exist."""
        compiled = backend.specialise(scene, numerics, self.probes)
        features = dict(compiled.features)
        if missing := self.features.keys() - features.keys():
            raise ValueError(f"the backend {compiled.backend} has no features {', '.join(sorted(missing))}")
        features |= self.features
        if self.walls:
            # walls of triangles need arrays that a scene without them does not have
            features["walls"] = tuple(sorted(backend.capabilities.walls - {TriangleMesh.model_fields["kind"].default}))
        return replace(compiled, features=tuple(sorted(features.items())))


def _law(**changes: object) -> Callable[[Scene], Scene]:
    return lambda scene: scene.model_copy(update={"contact": scene.contact.model_copy(update=changes)})


def _over_a_sheet(scene: Scene) -> Scene:
    """The scene with a sheet of triangles at rest on its bottom."""
    (left, front, _), (right, back, _) = scene.container.bounds.low, scene.container.bounds.high
    ends = np.array([(x, y, 0.0) for x in (left, right) for y in (front, back)])
    surface, _ = Triangles.welded(ends, np.array([[0, 1, 2], [1, 2, 3]]))
    sheet = Wall(name="sheet", shape=TriangleMesh.of_surface(surface))
    return scene.model_copy(update={"container": scene.container.model_copy(update={"parts": (sheet,)})})


def _as_clumps(scene: Scene) -> Scene:
    """The scene with clumps of one sphere each in place of its spheres."""
    grains = scene.grains
    size = {"diameter": grains.diameter, "density": grains.mean_density, "count": grains.count}
    return scene.model_copy(update={"grains": Clumps(centres=((0.0, 0.0, 0.0),), **size)})


def _start_of(scene: Scene, packing: Packing) -> Packing:
    """The packing of spheres as a start of a scene whose grains may have an orientation."""
    if not scene.grains.oriented:
        return packing
    turns, parts = np.tile([1.0, 0.0, 0.0, 0.0], (len(packing), 1)), np.zeros((len(packing.pairs), 2), np.int64)
    return replace(packing, q=turns, pair_parts=parts)


SKIPS = (
    Skip("kinds of walls that are not there", walls=True),
    Skip("friction", _law(friction=0.0, rolling_friction=0.0), {"FRICTION": True}),
    Skip("rolling resistance", _law(rolling_friction=0.0), {"ROLLING": True, "TWIST": True}),
    Skip("walls that move", features={"MOVING": True}),
    Skip("parts that move", _over_a_sheet, {"MOVING": True, "POSES": True}),
    Skip("an outlet", features={"OUTLET": True}),
    Skip("crossings of a plane", features={"CROSSING": True}),
    Skip("energies", features={"LEDGER": True}),
    Skip("periodic sides", features={"PERIODIC": True}),
    Skip("new lists of neighbours five times as often", numerics={"skin": 0.03}, falling=True),
    Skip("forces of walls at every beat", probes=(Traction(size=6e-3),)),
    Skip("frames of all grains at every beat", probes=(Sample(fields=("x", "v", "omega")),)),
    Skip("clumps of one sphere in place of spheres", restored=_as_clumps),
    Skip("contacts of the bed at every beat, as arches need them", probes=(Sample(fields=("x",)), Contacts())),
)


@dataclass(frozen=True)
class SkipSaving:
    """Saving of one skip: time without the skip over time with it, median and range over rounds.

    `same`: both states are equal in every bit after COMPARED beats. `difference`: their largest difference of
    positions [d].
    """

    name: str
    times: float
    low: float
    high: float
    same: bool
    difference: float


@dataclass(frozen=True)
class SkipsBench:
    """Savings of all skips of one backend on this machine, with `scenes` side by side, of `grains` each."""

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
        """Return plain values for JSON."""
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
    """Measure all skips of a backend, on one thread if it can be told how many to use.

    Args:
        name: Name of the backend.
        repeats: Rounds of each timing.
        device: Device to run on.
        precision: Precision to run in.
        say: Receives progress, and skips that the backend does not support.
        skips: Skips to measure.
        grains: Grains of each scene.

    Raises:
        BackendMissing: The backend is not installed.
    """
    whole = load(name)
    backend = on_one_thread(whole) or whole
    closed = fan(grains=grains).close()
    say(f"settling {grains} grains (compiles)")
    bed = settle(load("numba"), closed, FAN_STEP, SETTLED)
    numerics = FAN_STEP.model_copy(update={"steps_per_beat": STEPS_PER_BEAT, "precision": precision})
    say("filling from a rain and from a dense start")
    falls = [steps_to_rest(backend, device, closed, numerics, kind) for kind in ("rain", "dense")]
    saved = []
    for skip in skips:
        say(f"putting back {skip.name} (compiles)")
        start = place(closed, "gas", 1) if skip.falling else bed
        try:
            saved.append(measure(skip, backend, device, skip.scene(closed), numerics, start, repeats))
        except Unsupported as error:
            say(f"without {skip.name}: {error}")
    return SkipsBench(
        name, device, precision, hardware(), side_by_side(device), grains, tuple(saved), falls[0] / falls[1]
    )


def measure(
    skip: Skip, backend: Backend, device: str, scene: Scene, numerics: Numerics, start: Packing, repeats: int
) -> SkipSaving:
    """Measure the saving of `skip` in `scene`, from `start` on."""
    changed = numerics.model_copy(update=dict(skip.numerics))
    members = side_by_side(device)
    clock = time.process_time if members == 1 else time.perf_counter
    plain = backend.open(backend.specialise(scene, numerics), members, device)
    restored = skip.restored(scene)
    full = backend.open(skip.spec(backend, restored, changed), members, device)
    ends: list[Packing] = []
    for ensemble, parameters, of in ((plain, numerics, scene), (full, changed, restored)):
        admitted = [ensemble.admit(of, parameters, _start_of(of, start)) for _ in range(members)]
        _advance(ensemble, COMPARED, skip.name)
        ends.append(ensemble.packing(admitted[0]))
    timings: tuple[list[float], list[float]] = ([], [])
    for _ in range(repeats):
        for ensemble, times in zip((plain, full), timings, strict=True):
            began = clock()
            _advance(ensemble, TIMED, skip.name)
            times.append(clock() - began)
    plain.close()
    full.close()
    ratios = [slow / fast for fast, slow in zip(*timings, strict=True)]
    first, second = ends
    equal = all(np.array_equal(getattr(first, key), getattr(second, key)) for key in ("x", "v", "omega"))
    difference = float(np.abs(first.x - second.x).max()) / scene.grains.diameter
    return SkipSaving(skip.name, statistics.median(ratios), min(ratios), max(ratios), equal, difference)


def steps_to_rest(backend: Backend, device: str, closed: Scene, numerics: Numerics, kind: str) -> int:
    """Count the steps of a filling from the start called `kind` until it rests."""
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
    """Return the number of scenes that are timed together on `device`."""
    return 1 if device == "cpu" else ON_GPU


def _advance(ensemble: Ensemble, beats: int, name: str) -> None:
    """Advance beat by beat and fetch the rows after each, as runs do."""
    for _ in range(beats):
        events: Sequence[Any] = ensemble.advance(1)
        if failed := [event for event in events if isinstance(event, Failed)]:
            raise RuntimeError(f"{name}: {failed[0].message}")
        ensemble.drain()
