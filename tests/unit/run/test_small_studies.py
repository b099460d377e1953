"""Each study that ships, with few and soft grains and two seeds: its flow rate and packing fraction are as recorded.

`python tests/unit/run/test_small_studies.py [STUDY...]` records them in small_studies.json (some five minutes): do so
after a change that is meant to change them, and say so in CHANGELOG.md.

Trajectories are chaotic: on another processor, or after a change of the order of a sum, each run has other numbers, as
with other seeds. So means are compared by the scatter between seeds. Two seeds estimate it badly (one degree of
freedom), so a scatter counts as at least the root mean square of all recorded points. Four standard errors of a
difference are exceeded once in 16 000 comparisons, and there are about a hundred.
"""

import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
import pytest

pytest.importorskip("numba")

from labbook_numba import Backend

from labbook.backend.numerics import Numerics
from labbook.lab import Catalogue, LabFolder
from labbook.results.find import find
from labbook.results.points import RunResult
from labbook.run.runner import Runner
from labbook.scene import ConicalSilo, CylinderSilo, Scene, WedgeHopper
from labbook.scene.model import Model
from labbook.scene.timescales import collision
from labbook.study import Accuracy, Fill, Point, Stop, Study, load

STUDIES = sorted((Path(__file__).parents[3] / "studies").glob("*.yaml"))
RECORDED = Path(__file__).with_name("small_studies.json")
QUANTITIES = ("flow_rate", "packing_fraction", "wall_friction_flow", "drag.blade", "torque.drum")
SEEDS = 2
FACTOR = 4.0
SPHERES, RODS = 300, 180
"""Number of grains."""
NARROWEST = {WedgeHopper: 6.0, CylinderSilo: 5.0, ConicalSilo: 5.0}
"""Width of outlets through which few beds clog, in diameters of spheres."""
NARROWEST_OF_RODS = 3.0
"""The same in lengths of rods."""
STEP = 1.5e-5
"""Least time step [s], unless grains would have to be a thousand times softer."""
WINDOW = {"start": 0.15, "end": 0.55, "after": None, "until": None}
FED_FOR = 1.0
"""Time [s] for which a hopper is kept full, or a bed in a closed container is followed."""
M = TypeVar("M", bound=Model)


def reduced(study: Study) -> Study:
    """The first and the last point of a study with fewer and softer grains, in smaller containers and for a short time.

    Numerics that are swept become equal, but for the precision. A second point that becomes equal is left out.
    """
    ends = study.points[0], study.points[-1]
    narrowest = min(getattr(point.scene.container, "orifice", math.inf) for point in ends)
    points = [_point(point, index, narrowest) for index, point in enumerate(ends)]
    if _physics(points[0]) == _physics(points[1]):
        points.pop()
    window = study.window if study.fed else study.window.model_copy(update=WINDOW)
    endless = study.fed or points[0].scene.container.outlet_plane is None
    stop = Stop(max_time=FED_FOR) if endless else Stop(discharged=WINDOW["end"] + 0.05, stall=0.3)
    return replace(
        study,
        **{"points": tuple(points), "replicates": SEEDS, "accuracy": Accuracy(), "window": window, "stop": stop},
        **{"fit": (), "record": None, "reference": None},
    )


def _physics(point: Point) -> tuple[Scene, Fill, Numerics]:
    return point.scene, point.fill, point.numerics


def _point(point: Point, index: int, narrowest: float) -> Point:
    scene = _small(point.scene, narrowest)
    numerics = _soft(scene, point.numerics)
    filling = None if point.fill.numerics is None else _soft(scene, point.fill.numerics)
    settled = {"settled_below": 1e-3 if scene.grains.overhang > 0 else 1e-4, "moving": 0.05, "max_time": None}
    return replace(
        point,
        index=index,
        scene=scene,
        fill=point.fill.model_copy(update=settled | {"numerics": filling}),
        numerics=numerics,
    )


def _small(scene: Scene, narrowest: float) -> Scene:
    """The scene with few grains, its container smaller in proportion, and an outlet that grains flow through.

    Args:
        scene: one of the study. A container of single walls stays as it is: its study has few grains already, or
            no outlet.
        narrowest: the narrower outlet [m] of the two points.
    """
    grains, container = scene.grains, scene.container
    if not isinstance(container, WedgeHopper | CylinderSilo | ConicalSilo):
        few = container.outlet_plane is None and grains.count > SPHERES
        return _changed(scene, grains=_changed(grains, count=SPHERES)) if few else scene
    rods = grains.overhang > 0
    count = min(grains.count, RODS if rods else SPHERES)
    if isinstance(container, WedgeHopper):
        across, dimensions, width = "width", 2, container.width
    else:
        across, dimensions, width = "diameter", 3, container.diameter
    ratio = (count / grains.count) ** (1 / dimensions)
    length = grains.extent
    least = length * (NARROWEST_OF_RODS if rods else NARROWEST[type(container)])
    orifice = max(ratio * container.orifice, least * min(container.orifice / narrowest, 1.5))
    width = max(ratio * width, 1.5 * orifice)
    lengths = {"orifice": orifice, across: width}
    if isinstance(container, WedgeHopper) and container.gap is not None:
        lengths["gap"] = min(ratio * container.gap, (width - orifice) / 2)
    return _changed(scene, grains=_changed(grains, count=count), container=_changed(container, **lengths))


def _changed(model: M, **values: Any) -> M:
    """A model with other values [SI], validated."""
    return type(model)(**{name: getattr(model, name) for name in model.model_fields_set} | values)


def _soft(scene: Scene, numerics: Numerics) -> Numerics:
    """Numerics with a time step of a twentieth of a collision, that of grains which are soft enough for `STEP`."""
    scale = next(
        scale for scale in (1.0, 0.1, 0.01, 1e-3) if collision(scene.stiffened(scale)) / 20 >= STEP or scale == 1e-3
    )
    step = collision(scene.stiffened(scale)) / 20
    return numerics.model_copy(update={"dt": step, "stiffness_scale": scale, "steps_per_beat": 200})


Numbers = Mapping[str, Mapping[str, float]]
"""Of a point: quantity -> `mean` over seeds, `deviation` (standard, of a seed) and the number `n` of seeds."""


def measured(study: Study) -> dict[str, Numbers]:
    """Run a reduced study. Returns the numbers of each point by its label."""
    with TemporaryDirectory() as folder:
        lab = LabFolder(Path(folder))
        summary = Runner(study, lab, Backend(wide=True)).run()
        assert summary.done == summary.requested, summary.failed
        with closing(Catalogue(lab)) as catalogue:
            results = find(study, catalogue, "numba")
    return {point.point.label: _numbers(point.runs) for point in results.points}


def _numbers(runs: Sequence[RunResult]) -> Numbers:
    numbers = {}
    for quantity in QUANTITIES:
        values = [run.measured[quantity].value for run in runs if quantity in run.measured]
        values = [value for value in values if math.isfinite(value)]
        if values:
            deviation = np.std(values, ddof=1) if len(values) > 1 else 0.0
            spread = {"mean": float(np.mean(values)), "deviation": float(deviation), "n": len(values)}
            numbers[quantity] = {name: float(f"{value:.6g}") for name, value in spread.items()}
    return numbers


def typical(recorded: Mapping[str, Mapping[str, Numbers]], quantity: str) -> float:
    """Relative scatter of a quantity between seeds: root mean square over all points that are recorded."""
    numbers = [point[quantity] for points in recorded.values() for point in points.values() if quantity in point]
    scatters = [number["deviation"] / number["mean"] for number in numbers if number["n"] > 1]
    return math.sqrt(np.mean(np.square(scatters)))


def differing(now: Numbers, before: Numbers, scatter: Mapping[str, float]) -> list[str]:
    """Sentences on the numbers of a point that differ by more than `FACTOR` standard errors of the difference.

    A number that only some seeds had before, since others clogged, may be missing.

    Args:
        now, before: numbers of the point.
        scatter: quantity -> least relative scatter between seeds.
    """
    lines = [f"{name} is missing" for name in sorted(before.keys() - now.keys()) if before[name]["n"] == SEEDS]
    for name in sorted(now.keys() & before.keys()):
        errors = [
            max(number["deviation"], scatter[name] * number["mean"]) / math.sqrt(number["n"])
            for number in (now[name], before[name])
        ]
        mean, was, allowed = now[name]["mean"], before[name]["mean"], FACTOR * math.hypot(*errors)
        if abs(mean - was) > allowed:
            lines.append(f"{name} is {mean:.4g}, was {was:.4g}: more than {allowed:.2g} apart")
    return lines


def read() -> dict[str, dict[str, Numbers]]:
    return json.loads(RECORDED.read_text(encoding="utf-8"))


def test_every_study_that_ships_is_recorded_and_no_other():
    assert sorted(read()) == sorted(path.stem for path in STUDIES), f"run python {Path(__file__).name}"


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_a_reduced_study_has_few_grains_and_steps_and_the_same_laws(path):
    study = load(path)
    for point, original in zip(reduced(study).points, (study.points[0], study.points[-1]), strict=False):
        assert point.scene.grains.count <= 700
        assert point.numerics.dt >= 0.5 * STEP
        assert point.scene.contact == original.scene.contact
        assert type(point.scene.container) is type(original.scene.container)


def test_a_change_beyond_the_scatter_is_seen_and_one_within_it_is_not():
    before = {"flow_rate": {"mean": 1.0, "deviation": 0.0, "n": 2}}
    scatter = {"flow_rate": 0.025}  # the standard error of a difference of two means of two
    assert not differing({"flow_rate": {"mean": 1.09, "deviation": 0.0, "n": 2}}, before, scatter)
    assert differing({"flow_rate": {"mean": 1.11, "deviation": 0.0, "n": 2}}, before, scatter)
    assert not differing({"flow_rate": {"mean": 1.11, "deviation": 0.1, "n": 2}}, before, scatter)
    assert differing({}, before, scatter) == ["flow_rate is missing"]
    assert not differing({}, {"flow_rate": {"mean": 1.0, "deviation": 0.0, "n": 1}}, scatter)


@pytest.mark.compiles
@pytest.mark.ring
@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_a_reduced_study_gives_its_recorded_numbers(path):
    recorded = read()
    scatter = {quantity: typical(recorded, quantity) for quantity in QUANTITIES}
    now, before = measured(reduced(load(path))), recorded[path.stem]
    assert now.keys() == before.keys()
    assert not {label: lines for label in now if (lines := differing(now[label], before[label], scatter))}


def record(names: Sequence[str]) -> None:
    """Run the reduced studies of these names, all without names, and record their numbers; those done before stay."""
    recorded = read() if RECORDED.exists() else {}
    for path in STUDIES:
        if not names or path.stem in names:
            begun = time.process_time()
            recorded[path.stem] = measured(reduced(load(path)))
            print(f"{path.stem}: {time.process_time() - begun:.1f} s, {recorded[path.stem]}", flush=True)
            stay = {name: recorded[name] for name in (path.stem for path in STUDIES) if name in recorded}
            RECORDED.write_text(json.dumps(stay, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    record(sys.argv[1:])
