"""When a filling ends: at rest, at rest but for a grain that rolls on, or not at all."""

import json
import math

import labbook_toy
import numpy as np
import pytest
from toy_lab import carry_out, study

from labbook.filling.bed import at_rest, fastest_points, outside_container
from labbook.lab.packings import ARRAYS, read_packing
from labbook.lab.records import RunRecord, Unreadable
from labbook.lab.runs import check_keys
from labbook.lab.tables import write_table
from labbook.plan.demand import demands
from labbook.run.watch import NullWatcher
from labbook.scene import (
    CylinderSilo,
    LinearSpringDashpot,
    Packing,
    Plane,
    Primitives,
    Scene,
    Spheres,
    Spherocylinders,
    Strip,
    Wall,
)
from labbook.study import load

BRAKED = "rolling_friction: 0.01, friction: 0.5"


def rolls_on(grains: int, speed: float):
    """The toy's beat, but for some grains of a closed container, which keep `speed` [m/s]."""
    beat = labbook_toy.Glass.beat

    def rolling(glass, *films):
        rows = beat(glass, *films)
        if labbook_toy.outlet_height(glass.scene) is None:
            glass.v[:grains] = [speed, 0, 0]
        return rows

    return rolling


def asked_of(folder, *more, braked=False, **sizes):
    path = study(folder, *more, replicates=1, orifices="[24]", **sizes).path
    if braked:
        path.write_text(path.read_text().replace("friction: 0.5", BRAKED))
    return load(path)


def test_one_grain_that_rolls_on_does_not_keep_a_bed_from_resting(tmp_path, monkeypatch):
    monkeypatch.setattr(labbook_toy.Glass, "beat", rolls_on(1, 0.3))
    assert not carry_out(asked_of(tmp_path), tmp_path / "lab").tally.failed


@pytest.mark.parametrize(
    ("grains", "more", "braked"),
    [
        (3, "", False),  # of 200 grains at most two may move
        (1, "fill: {settled_below: 1e-6, max_time: 0.4 s}", False),
        (1, "fill: {moving: 0, max_time: 0.4 s}", False),
        (1, "", True),
    ],
)
def test_more_grains_or_one_that_should_come_to_rest_do(tmp_path, monkeypatch, grains, more, braked):
    monkeypatch.setattr(labbook_toy.Glass, "beat", rolls_on(grains, 0.3))
    more = more or "fill: {max_time: 0.4 s}"
    (said,) = carry_out(asked_of(tmp_path, more, braked=braked), tmp_path / "lab").tally.failed
    assert "not at rest after 0.4 s" in said


@pytest.mark.parametrize("steps", [1000, 5])
def test_a_dense_start_has_to_stay_calm_for_a_time(tmp_path, monkeypatch, steps):
    """From rest a bed that falls freely passes 1e-3 m g d within 0.045 sqrt(d/g): a start at rest is not at rest."""
    admitted = []
    admit = labbook_toy.Ensemble.admit

    def watched(ensemble, scene, numerics, start, **how):
        if scene.container.closed:
            admitted.append((scene, numerics, how["settled_below"], how["settled_beats"]))
        return admit(ensemble, scene, numerics, start, **how)

    monkeypatch.setattr(labbook_toy.Ensemble, "admit", watched)
    asked = asked_of(tmp_path, "fill: {kind: dense}").change({"numerics.steps_per_beat": steps})
    assert not carry_out(asked, tmp_path / "lab").tally.failed
    ((scene, numerics, below, beats),) = admitted
    unit = math.sqrt(scene.grains.diameter / scene.gravity)
    fallen = scene.gravity * (beats - 1) * numerics.beat
    assert below == 1e-3 < fallen**2 / 2 / (scene.gravity * scene.grains.diameter)
    assert beats == 2 or (beats - 2) * numerics.beat < 0.5 * unit, "and no longer than needed"


@pytest.mark.parametrize(
    ("fill", "below", "moving"),
    [
        ("{kind: dense}", 1e-3, 0.0),
        ("{kind: dense, settled_below: 1e-2}", 1e-2, 0.0),
        ("{kind: dense, moving: 5 %}", 1e-3, 0.05),
        ("{kind: gas}", 1e-6, 0.01),
    ],
)
def test_a_kind_of_start_brings_its_own_rest(tmp_path, fill, below, moving):
    """These spheres roll for ever, which a gas allows 1 % of them, and a dense start has no need to."""
    (demand,) = demands(asked_of(tmp_path, f"fill: {fill}"), 1)
    assert (demand.filling.settled_below, demand.filling.moving) == (below, moving)


def test_a_stated_fraction_may_move(tmp_path, monkeypatch):
    monkeypatch.setattr(labbook_toy.Glass, "beat", rolls_on(10, 0.3))
    asked = asked_of(tmp_path, "fill: {moving: 5 %, settled_below: 1e-6}")
    assert not carry_out(asked, tmp_path / "lab").tally.failed


@pytest.mark.parametrize(
    ("more", "braked", "moving"),
    [
        ("", False, 0.01),
        ("", True, 0.0),
        ("fill: {settled_below: 1e-6}", False, 0.0),
        ("fill: {settled_below: 1e-6, moving: 2 %}", False, 0.02),
        ("fill: {moving: 2 %}", True, 0.02),
    ],
)
def test_grains_may_move_where_nothing_brakes_them_and_no_threshold_is_stated(tmp_path, more, braked, moving):
    (demand,) = demands(asked_of(tmp_path, *([more] if more else []), braked=braked), 1)
    assert demand.filling.moving == moving


def bed(grains) -> Scene:
    silo = CylinderSilo(diameter=0.05, height=1, orifice=0.02)
    return Scene(grains=grains, contact=LinearSpringDashpot(normal_stiffness=1e3), container=silo, gravity=9.81)


def packing_of(v, omega) -> Packing:
    return Packing(x=np.zeros_like(v), v=v, omega=omega)


def test_the_fastest_point_of_a_grain_is_that_of_a_rigid_body():
    rng = np.random.default_rng(1)
    for grains in (Spheres(diameter=3e-3, density=2e3, count=50), Spherocylinders(
        diameter=3e-3, length=9e-3, density=2e3, count=50
    )):  # fmt: skip
        v, omega = rng.normal(size=(2, 50, 3))
        ends = rng.normal(size=(500, 3))
        ends *= (grains.radius + grains.half_length) / np.linalg.norm(ends, axis=1)[:, None]
        points = v[:, None] + np.cross(omega[:, None], ends[None])
        fastest = np.linalg.norm(points, axis=2).max(axis=1)
        assert (fastest <= fastest_points(grains, packing_of(v, omega)) * (1 + 1e-12)).all()


def test_a_bed_is_at_rest_when_its_slow_grains_have_the_energy_asked_for():
    scene = bed(Spheres(diameter=3e-3, density=2e3, count=100))
    just = math.sqrt(2 * 1e-6 * 9.81 * 3e-3)  # v^2/2 = 1e-6 g d
    v = np.zeros((100, 3))
    v[:, 0] = 0.99 * just
    v[:2, 0] = 1.0
    still = np.zeros_like(v)
    assert at_rest(scene, packing_of(v, still), 1e-6, 0.02)
    assert not at_rest(scene, packing_of(v, still), 1e-6, 0.01)
    assert not at_rest(scene, packing_of(1.02 * v, still), 1e-6, 0.02)
    few = bed(Spheres(diameter=3e-3, density=2e3, count=30))
    assert at_rest(few, packing_of(v[1:31], still[:30]), 1e-6, 0.01), "one grain may always move"
    alone = bed(Spheres(diameter=3e-3, density=2e3, count=1))
    assert not at_rest(alone, packing_of(v[:1], still[:1]), 1e-6, 0.01), "but not the only one"
    assert at_rest(alone, packing_of(v[2:3], still[:1]), 1e-6, 0.01)


class Listening(NullWatcher):
    """Keeps what is told."""

    def __init__(self):
        self.told = []

    def tell(self, line: str) -> None:
        self.told.append(line)


def test_a_bed_that_does_not_come_to_rest_is_told_early_and_once(tmp_path, monkeypatch):
    monkeypatch.setattr(labbook_toy.Glass, "beat", rolls_on(3, 0.3))
    heard = Listening()
    summary = carry_out(asked_of(tmp_path, "fill: {max_time: 6 s}"), tmp_path / "lab", watcher=heard)
    (said,) = heard.told
    energy = 3 * 0.3**2 / 2 / 200 / (9.81 * 3e-3)
    assert f"its kinetic energy is {energy:.2g} m g d per grain, at rest below 1e-6" in said
    assert "the step is 1e-05 s, 0.017 of a collision" in said
    assert "fill.max_time (6 s)" in said
    when = float(said.split("at ")[1].split(" s")[0])
    assert when < 2.5, "long before fill.max_time"
    (failed,) = summary.tally.failed
    assert "not at rest after 6 s" in failed


def test_a_bed_that_comes_to_rest_is_not_told(tmp_path):
    heard = Listening()
    assert not carry_out(asked_of(tmp_path), tmp_path / "lab", watcher=heard).tally.failed
    assert not heard.told


def jitters(energy: float, times: float = math.inf):
    """The toy's beat, but grains of a closed container keep a kinetic energy per grain [m g d] for so many seconds."""
    beat = labbook_toy.Glass.beat

    def shaking(glass, *films):
        rows = beat(glass, *films)
        if labbook_toy.outlet_height(glass.scene) is None and glass.time < times:
            glass.v[:] = [0.0, 0.0, math.sqrt(2 * energy * 9.81 * 3e-3)]
        return rows

    return shaking


def test_a_bed_that_hovers_ends_early_with_the_threshold_that_accepts_it(tmp_path, monkeypatch):
    """8e-6 m g d is what a bed with strong rolling springs keeps; 1.2 times that, to one digit upwards, is 1e-5."""
    monkeypatch.setattr(labbook_toy.Glass, "beat", jitters(8e-6))
    (said,) = carry_out(asked_of(tmp_path, braked=True), tmp_path / "lab").tally.failed
    assert "the bed hovers: at " in said
    assert float(said.split("at ")[1].split(" s")[0]) < 10, "not after 60 s"
    assert "use fill.settled_below: 1e-5, which accepts it as it is" in said
    assert "rolling_friction" not in said, "these grains have it"
    accepted = asked_of(tmp_path, "fill: {settled_below: 1e-5}", braked=True)
    assert not carry_out(accepted, tmp_path / "lab").tally.failed


def test_a_filling_that_hovered_goes_on_when_asked_again(tmp_path, monkeypatch):
    monkeypatch.setattr(labbook_toy.Glass, "beat", jitters(8e-6))
    asked = asked_of(tmp_path, braked=True)
    (said,) = carry_out(asked, tmp_path / "lab").tally.failed
    end = float(said.split("at ")[1].split(" s")[0])
    monkeypatch.undo()
    monkeypatch.setattr(labbook_toy.Glass, "beat", jitters(8e-6, end + 0.5))
    assert not carry_out(asked, tmp_path / "lab").tally.failed, "it came to rest by itself"
    (packing,) = (tmp_path / "lab/packings").iterdir()
    assert end < json.loads((packing / "packing.json").read_text())["duration"] < end + 2


@pytest.mark.parametrize("count", [1, 3])
def test_few_grains_that_roll_on_are_told_what_helps(tmp_path, monkeypatch, count):
    """A single grain on a plane rolls for ever; that more of them may move does not help."""
    monkeypatch.setattr(labbook_toy.Glass, "beat", jitters(5e-6))
    asked = asked_of(tmp_path, "window: {start: 0, end: 1}", count=count)
    (said,) = carry_out(asked, tmp_path / "lab").tally.failed
    assert "use fill.settled_below: 6e-6, which accepts it as it is" in said
    assert "contact.rolling_friction" in said
    assert "fill.moving" not in said


def test_grains_that_are_lost_while_filling_end_it(tmp_path, monkeypatch):
    beat = labbook_toy.Glass.beat

    def leaking(glass, *films):
        rows = beat(glass, *films)
        if labbook_toy.outlet_height(glass.scene) is None and glass.time > 0.003:
            glass.x[[3, 7]] = [0.001, 0.0, -0.05]
        return rows

    monkeypatch.setattr(labbook_toy.Glass, "beat", leaking)
    (said,) = carry_out(asked_of(tmp_path), tmp_path / "lab").tally.failed
    assert "2 of 200 grains have left the container by 0.0" in said
    assert "x, y, z = 1, 0, -50 mm" in said
    assert not (tmp_path / "lab/packings").exists()


def test_grains_that_a_backend_dropped_while_filling_end_it(tmp_path, monkeypatch):
    beat = labbook_toy.Glass.beat

    def leaking(glass, *films):
        rows = beat(glass, *films)
        if labbook_toy.outlet_height(glass.scene) is None and glass.step == 2 * glass.numerics.steps_per_beat:
            glass.x, glass.v, glass.ids = glass.x[1:], glass.v[1:], glass.ids[1:]
        return rows

    monkeypatch.setattr(labbook_toy.Glass, "beat", leaking)
    (said,) = carry_out(asked_of(tmp_path), tmp_path / "lab").tally.failed
    assert "1 of 200 grains have left the container by 0.004 s" in said
    assert "through container.outlet_plane (z = 0 mm)" in said
    assert not (tmp_path / "lab/packings").exists()


def test_a_packing_that_lost_grains_is_refused(tmp_path):
    """As older versions kept them: the record counts all grains of the scene."""
    lab, asked = tmp_path / "lab", asked_of(tmp_path)
    carry_out(asked, lab)
    (folder,) = (lab / "packings").iterdir()
    record, packing = read_packing(folder)
    assert record.grains == len(packing) == 200
    there = {name: array[:-5] if name in ("x", "v", "omega", "ids") else array
             for name, array in packing.arrays().items()}  # fmt: skip
    write_table(folder / ARRAYS, there)
    record.model_copy(update={"arrays": None}).write(folder)  # as before there were seals of arrays
    with pytest.raises(Unreadable, match="195 of 200 grains"):
        read_packing(folder)


def test_a_run_that_began_with_fewer_grains_is_refused(tmp_path):
    """As from a packing of an older version that had lost some: it is not done, and is made again."""
    lab, asked = tmp_path / "lab", asked_of(tmp_path)
    carry_out(asked, lab)
    (folder,) = (lab / "runs").iterdir()
    record = RunRecord.read(folder)
    check_keys(folder, record)
    assert record.ledger is not None
    short = record.model_copy(update={"ledger": record.ledger.model_copy(update={"started": 3})})
    with pytest.raises(Unreadable, match="began with 3 of 200 grains"):
        check_keys(folder, short)


def test_grains_outside_a_container_are_found():
    """Behind a wall, below the plane of the outlet, and where there is none below the lowest plate."""
    grains = Spheres(diameter=3e-3, density=2e3, count=4)
    law = LinearSpringDashpot(normal_stiffness=1e3)
    x = np.array([[0, 0, 1.5e-3], [0, 0, -1e-3], [0.03, 0, 0.1], [0, 0, -0.02]])
    silo = Scene(grains=grains, contact=law, container=CylinderSilo(diameter=0.05, height=1, orifice=0.02)).close()
    assert outside_container(silo, Packing(x=x, v=0 * x, omega=0 * x)).tolist() == [False, True, True, True]
    plate = Wall(name="plate", shape=Strip(start=(-1, -0.01), end=(1, -0.01)))
    for plane, lost in ((None, [False, False, False, True]), (0.0, [False, True, False, True])):
        parts = Primitives(parts=(plate,), outlet_plane=plane)
        free = Scene(grains=grains, contact=law, container=parts)
        assert outside_container(free, Packing(x=x, v=0 * x, omega=0 * x)).tolist() == lost
    tilted = Wall(name="tilted", shape=Plane(point=(0, 0, -0.1), normal=(0.1, 0, 1)))
    free = Scene(grains=grains, contact=law, container=Primitives(parts=(plate, tilted)))
    assert not outside_container(free, Packing(x=x, v=0 * x, omega=0 * x)).any(), (
        "an inclined plane goes on below the plate"
    )
