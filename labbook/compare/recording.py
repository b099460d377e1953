"""A rerun recording of both backends' first seconds from the same packing, side by side on one clock."""

from pathlib import Path

import numpy as np

from labbook.backend.probes import film_probe
from labbook.compare.lockstep import side_by_side
from labbook.compare.sides import Pair, from_shared
from labbook.export.recording import FRAMES, frames_of, front_view, log_bar, log_grains, need_rerun, top_speed, written
from labbook.lab.folder import Lab
from labbook.lab.packings import load_packing
from labbook.study import Point, Study

SEED = 1
"""Of the packing from which backends are followed."""


def record(study: Study, point: Point, lab: Lab, pair: Pair, seconds: float, path: Path) -> Path:
    """Step both backends for `seconds` from the first one's packing at `point`, and write what they did to `path`
    (.rrd), in place by one rename. Raises ViewerMissing, Unreadable or Unsupported."""
    need_rerun()
    import rerun.blueprint as rrb

    demands = [shared.run(SEED) for shared in from_shared(study, point, pair)]
    keys = [demand.keys(one.can) for demand, one in zip(demands, pair, strict=True)]
    scene, names = point.scene, [one.entrant.called for one in pair]
    fields = film_probe(seconds / FRAMES, point.numerics, scene.grains).fields
    frames = [one for one in side_by_side(pair, demands[0], lab, seconds / FRAMES, seconds, fields) if not one.over]
    films = []
    for tables in zip(*(frame.tables for frame in frames), strict=True):
        films.append(frames_of({name: np.concatenate([table[name] for table in tables]) for name in tables[0]}))
    fastest = max(top_speed(scene, film) for film in films)
    views = rrb.Horizontal(
        *(front_view(scene, film, origin=name, name=name) for name, film in zip(names, films, strict=True))
    )
    title = f"{study.name}: {point.label}, seed {SEED}, {names[0]} beside {names[1]}"
    start = load_packing(lab.packing(keys[0].packing))
    with written(path, title, "-".join(one.run for one in keys), scene, views) as stream:
        for name, film in zip(names, films, strict=True):
            log_grains(stream, name, scene, start, film, fastest)
        log_bar(stream, scene, fastest)
    return path
