"""Two backends that start from the same packing, stepped side by side: how long they agree, and a recording of both.

Backends add up forces in different orders. Their rounding errors, some 1e-16 of a diameter at first, grow exponentially
in flowing grains, as any difference does; when they reach a diameter the two discharges are different replicates.
"""

import math
import time
from collections.abc import Generator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labbook.backend import Failed
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Sample, Table, film_probe
from labbook.checks.compare.sides import Pair, Side, from_shared
from labbook.checks.compare.verdict import Divergence
from labbook.export.entities import log_grains, need_rerun
from labbook.export.frames import FRAMES, at_opening, frames_of, top_speed
from labbook.export.recording import rrd_stream
from labbook.export.views import above_bar, front_view, log_bars
from labbook.filling import start_of_discharge
from labbook.lab.folder import LabFolder
from labbook.lab.packings import load_packing
from labbook.plan.demand import Demand
from labbook.scene import Packing, Scene
from labbook.scene.model import digest
from labbook.study import Point, Study

AGREE = 1e-3
"""Largest difference of a position [d] at which the backends still agree."""
APART = 1.0
"""Largest difference of a position [d] at which the comparison ends."""
LONGEST = 50.0
"""Longest simulated time of the comparison [sqrt(d/g)]."""
SEED = 1
"""Seed of the packing that is recorded."""
_INTERVAL = 0.05  # between frames [sqrt(d/g)]


@dataclass(frozen=True)
class FramePair:
    """The same moment in both backends.

    Args:
        time: Time since the opening [s].
        tables: Rows of the sample of each backend, sorted by grain id.
        rates: Grain-steps per second of each backend so far, without its first beat, which may compile kernels.
        failure: Message of the guard that stopped one of the backends; empty if none did.
    """

    time: float
    tables: tuple[Table, Table]
    rates: tuple[float | None, float | None]
    failure: str = ""

    @property
    def has_ended(self) -> bool:
        """True if a guard stopped one of the backends, or one has no grains left."""
        return bool(self.failure) or not all(len(table["id"]) for table in self.tables)


def side_by_side(
    pair: Pair, demand: Demand, lab: LabFolder, every: float, seconds: float, fields: tuple[str, ...]
) -> Generator[FramePair]:
    """Step a run of the first side on both backends.

    Args:
        pair: The two sides.
        demand: The run.
        lab: Lab with the packing.
        every: Time between frames, about [s].
        seconds: Longest simulated time [s].
        fields: Fields of the sample.

    Yields:
        A frame for each interval; the frame in which one side is over is the last.

    Raises:
        Unreadable: The packing cannot be read.
        Unsupported: A backend cannot run the scene.
    """
    shared = demand.shared
    packing = load_packing(lab.packing(demand.keys(pair[0].can).packing))
    start = start_of_discharge(packing.entered, shared.closed, shared.scene)
    beat = {"steps_per_beat": max(1, round(every / shared.numerics.dt))}
    numerics = shared.numerics.model_copy(update=beat)
    with (
        closing(_alone(pair[0], shared.scene, numerics, start, fields)) as first,
        closing(_alone(pair[1], shared.scene, numerics, start, fields)) as second,
    ):
        for number in range(1, int(seconds / numerics.beat * (1 + 1e-9)) + 1):
            (a, rate, why), (b, other_rate, other_why) = next(first), next(second)
            frame = FramePair(number * numerics.beat, (a, b), (rate, other_rate), why or other_why)
            yield frame
            if frame.has_ended:
                return


def _alone(
    side: Side, scene: Scene, numerics: Numerics, start: Packing, fields: tuple[str, ...]
) -> Generator[tuple[Table, float | None, str]]:
    """Yield, for every beat of one backend, its rows, its speed so far, and the message of a failure."""
    numerics, probe = side.numerics(numerics), Sample(fields=fields, every=1)
    ensemble = side.backend.open(side.backend.specialise(scene, numerics, (probe,)), 1, side.device)
    try:
        member = ensemble.admit(scene, numerics, start)
        before, work, wall, warm = ensemble.status(member), 0.0, 0.0, False
        while True:
            begun = time.perf_counter()
            events = ensemble.advance(1)
            took, now = time.perf_counter() - begun, ensemble.status(member)
            if warm:
                wall += took
                work += (now.step - before.step) * (now.grains + before.grains) / 2
            before, warm = now, True
            rows = ensemble.drain()[probe]
            order = np.argsort(rows["id"], kind="stable")
            table = {name: np.asarray(column)[order] for name, column in rows.items()}
            failure = next((event.message for event in events if isinstance(event, Failed)), "")
            yield table, work / wall if wall else None, failure
    finally:
        ensemble.close()


def divergence(
    pair: Pair, demands: tuple[Demand, Demand], lab: LabFolder, earlier: Mapping[str, Divergence]
) -> Divergence:
    """Measure the divergence of one run between both backends, from the first side's packing.

    Args:
        pair: The two sides.
        demands: The run on each side.
        lab: Lab with the packing.
        earlier: Results of an earlier comparison by key; one with the same key is returned as it is.

    Returns:
        Differences of positions against time.

    Raises:
        Unreadable: The packing cannot be read.
        Unsupported: A backend cannot run the scene.
    """
    keys = [demand.keys(side.can).run for side, demand in zip(pair, demands, strict=True)]
    key = digest({"runs": keys, "devices": [side.device for side in pair], "looks": [AGREE, APART, LONGEST, _INTERVAL]})
    if key in earlier:
        return earlier[key]
    scene = demands[0].shared.scene
    tick = math.sqrt(scene.grains.diameter / scene.gravity)
    times, medians, largest = [0.0], [0.0], [0.0]
    ended, note, rates = "longest", "", (None, None)
    with closing(side_by_side(pair, demands[0], lab, _INTERVAL * tick, LONGEST * tick, ("x",))) as frames:
        for frame in frames:
            note, rates = frame.failure, frame.rates
            apart = distances(frame) / scene.grains.diameter
            if frame.has_ended or not len(apart):
                ended = "failed" if note else "empty"
                break
            times.append(frame.time)
            medians.append(float(np.median(apart)))
            largest.append(float(apart.max()))
            if largest[-1] >= APART:
                ended = "diverged"
                break
    agreed = next((k for k, value in enumerate(largest) if value > AGREE), len(largest)) - 1
    return Divergence(
        key=key, seed=demands[0].seed, time=tuple(times), median=tuple(medians), largest=tuple(largest),
        agree_until=times[agreed], ended=ended, note=note, rates=rates,
    )  # fmt: skip


def distances(frame: FramePair) -> np.ndarray:
    """Compute the distances [m] between the two positions of every grain that both backends still have."""
    a, b = frame.tables
    _, here, there = np.intersect1d(a["id"], b["id"], assume_unique=True, return_indices=True)
    apart = [np.asarray(a[axis])[here] - np.asarray(b[axis])[there] for axis in "xyz"]
    return np.sqrt(sum(part**2 for part in apart))


def record(study: Study, point: Point, lab: LabFolder, pair: Pair, seconds: float, path: Path) -> Path:
    """Record both backends side by side on one clock, from the first side's packing.

    Args:
        study: The study.
        point: Point of the study.
        lab: Lab with the packing.
        pair: The two sides.
        seconds: Simulated time [s].
        path: File to write (.rrd); it appears by one rename, complete.

    Returns:
        `path`.

    Raises:
        ViewerMissing: Rerun is not installed.
        Unreadable: The packing cannot be read.
        Unsupported: A backend cannot run the scene.
    """
    need_rerun()
    import rerun.blueprint as rrb

    demands = [shared.run(SEED) for shared in from_shared(study, point, pair)]
    keys = [demand.keys(side.can) for demand, side in zip(demands, pair, strict=True)]
    scene, names = point.scene, [side.entrant.called for side in pair]
    fields = film_probe(seconds / FRAMES, scene.grains).fields
    start = start_of_discharge(load_packing(lab.packing(keys[0].packing)).entered, demands[0].shared.closed, scene)
    frames = [
        frame for frame in side_by_side(pair, demands[0], lab, seconds / FRAMES, seconds, fields) if not frame.has_ended
    ]
    films = []
    for tables in zip(*(frame.tables for frame in frames), strict=True):
        films.append(frames_of({name: np.concatenate([table[name] for table in tables]) for name in tables[0]}))
    fastest = max(top_speed(scene, film) for film in films)
    views = rrb.Horizontal(
        *(front_view(scene, film, origin=name, name=name, by="speed") for name, film in zip(names, films, strict=True))
    )
    title = f"{study.name}: {point.label}, seed {SEED}, {names[0]} beside {names[1]}"
    for film in films:
        film.insert(0, at_opening(start, film[0].q is not None))
    layout = above_bar(views, scene, title)
    with rrd_stream(path, title, "-".join(run_keys.run for run_keys in keys), layout, films[0][-1].time) as stream:
        for name, film in zip(names, films, strict=True):
            log_grains(stream, name, scene, start, film, fastest)
        log_bars(stream, scene, fastest)
    return path
