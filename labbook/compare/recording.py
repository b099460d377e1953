"""A rerun recording of both backends' first seconds from the same packing, side by side on one clock."""

import os
from pathlib import Path

import numpy as np

from labbook.backend.probes import film_probe
from labbook.compare.compare import SEED, demands
from labbook.compare.lockstep import Frame, side_by_side
from labbook.compare.pair import Pair
from labbook.export.recording import (
    FRAMES,
    above_bar,
    frames_of,
    front_view,
    log_bar,
    log_grains,
    need_rerun,
    resting,
    top_speed,
)
from labbook.filling import opened
from labbook.lab.folder import Lab
from labbook.lab.packings import load_packing
from labbook.run.demand import PointDemand
from labbook.study import Point, Study


def record(study: Study, point: Point, lab: Lab, pair: Pair, seconds: float, path: Path) -> Path:
    """Step both backends for `seconds` from the first one's packing at `point`, and write what they did to `path`
    (.rrd), in place by one rename. Raises ViewerMissing, Unreadable or Unsupported."""
    rr = need_rerun()
    import rerun.blueprint as rrb

    runs = [demands(study, point, pair, one, SEED)[-1].keys(one.can) for one in pair]
    shared = PointDemand(study, point)
    start = opened(load_packing(lab.packing(runs[0].packing)), shared.closed, shared.scene)
    every = seconds / FRAMES
    numerics = shared.numerics.model_copy(update={"steps_per_beat": max(1, round(every / shared.numerics.dt))})
    with side_by_side(pair, shared.scene, numerics, start, film_probe(every, numerics, shared.scene.grains)) as both:
        seen = list(both.frames(seconds))
    films = [frames_of(_joined(seen, which)) for which in (0, 1)]
    fastest = max(top_speed(shared.scene, film) for film in films)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    path.parent.mkdir(parents=True, exist_ok=True)
    shown = zip(pair, films, strict=True)
    beside = rrb.Horizontal(*(front_view(shared.scene, film, origin=one.name, name=one.name) for one, film in shown))
    stream = rr.RecordingStream("labbook", recording_id="-".join(one.run for one in runs))
    try:
        stream.save(partial, default_blueprint=resting(above_bar(beside, shared.scene, [])))
        stream.send_recording_name(f"{study.name}: {point.label}, seed {SEED}, {pair[0].name} beside {pair[1].name}")
        for one, film in zip(pair, films, strict=True):
            log_grains(stream, one.name, shared.scene, start, film, fastest)
        log_bar(stream, shared.scene, fastest)
        stream.flush()
        stream.disconnect()
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
    return path


def _joined(frames: list[Frame], which: int) -> dict[str, np.ndarray]:
    """All rows that one backend gave."""
    tables = [frame.tables[which] for frame in frames]
    return {name: np.concatenate([np.asarray(table[name]) for table in tables]) for name in tables[0]}
