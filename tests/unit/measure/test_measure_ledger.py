"""Overlaps and energies of a run: of rows made by hand, of motions with known answers, and of a discharge."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from labbook_toy import Backend as Toy
from platforms import Bundled, platforms, sharing, where
from toy_lab import carry_out, study

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Ledger, columns
from labbook.checks.verify.materials import G, floor, hertz, room
from labbook.checks.verify.platform import MemberStart, grains_at
from labbook.checks.verify.rods import ROD, rods_at
from labbook.lab import Catalogue, LabFolder
from labbook.lab.folder import EVALUATION
from labbook.lab.runs import open_run
from labbook.measure import MEASURES, Evaluation, MeasureError, RunData
from labbook.plan.advice import PACKED
from labbook.plan.plan import Planner
from labbook.run.runner import Runner
from labbook.scene import Box, HertzMindlin, Kind, LinearSpringDashpot, Packing, Primitives, Scene, Spheres, WedgeHopper
from labbook.study import load
from labbook.study.schema import Window

MEASURE = MEASURES["ledger"]
D, K = 3e-3, 1e3
SPHERE = Spheres(diameter=D, density=2500, count=1)
MIXED = (Kind(name="large", share=0.5), Kind(name="small", share=0.5, diameter=D / 3, density=7800))
HOPPER = WedgeHopper(width=0.06, height=0.3, thickness=1.01 * D, orifice=0.024)
N, RATE, WINDOW = 1000, 500.0, Window(start=0.1, end=0.5)


def linear(grains, container, gravity=G, **law) -> Scene:
    contact = LinearSpringDashpot(normal_stiffness=K, **law)
    return Scene(grains=grains, contact=contact, container=container, gravity=gravity)


def by_hand(of: Spheres | None = None, changed: Mapping[str, np.ndarray] | None = None) -> RunData:
    """N grains leave evenly, RATE a second, so that the window is 0.2 to 1 s; a row every 10 ms.

    changed: columns of the ledger in place of these.
    """
    time = 0.01 * np.arange(1, 121)
    table = {name: np.zeros(len(time), kind) for name, kind in columns(Ledger()).items()}
    table |= {"time": time, "contact_work": -0.02 * time, "kinetic": 0.5 * time, "grains": N - np.arange(120)}
    table |= {"max_overlap": np.where(time < 0.15, 60e-6, np.where(time < 0.605, 12e-6, 24e-6))}
    scene = linear(of or SPHERE.model_copy(update={"count": N}), HOPPER)
    start = Packing(x=np.zeros((N, 3)), v=np.zeros((N, 3)), omega=np.zeros((N, 3)))
    if scene.grains.kinds:
        start = replace(start, kind=np.arange(N) % 2, diameter=np.where(np.arange(N) % 2, D / 3, D))
    left = {"time": np.arange(1, 601) / RATE, "id": np.arange(600)}
    tables = {"crossing": left, "ledger": {**table, **(changed or {})}}
    return RunData(scene, Numerics(dt=1e-5), 1, start, "finished", 1.2, tables)


def numbers(found: Evaluation) -> dict[str, float]:
    return {one.quantity: one.value for one in found.numbers}


def test_largest_overlap_of_the_run_and_means_of_the_window():
    found = MEASURE.evaluate(by_hand(), WINDOW)
    # the deepest rows are before the window, which has 41 rows of 12 um (0.2 to 0.6 s) and 40 of 24 um
    mean = (41 * 12e-6 + 40 * 24e-6) / 81
    expected = {"max_overlap": 0.02, "mean_max_overlap": mean / D, "contact_loss": 0.02}
    assert numbers(found) == pytest.approx(expected)
    assert {one.quantity: one.unit for one in found.numbers} == {one.name: one.unit for one in MEASURE.declared[:3]}
    assert all("sample" in one.method for one in found.numbers)
    assert set(found.arrays) == {"time", "kinetic", "potential", "contact_work", "max_overlap", "grains"}
    assert found.arrays["max_overlap"].max() == numbers(found)["max_overlap"]
    assert found.arrays["kinetic"] == pytest.approx(0.5 * found.arrays["time"])


def test_the_window_alone_decides_the_power():
    time = by_hand().tables["ledger"]["time"]
    # contacts take 0.1 W outside the window, and 0.03 W within
    work = -np.interp(time, [0, 0.2, 1, 1.2], np.cumsum([0, 0.1 * 0.2, 0.03 * 0.8, 0.1 * 0.2]))
    found = numbers(MEASURE.evaluate(by_hand(changed={"contact_work": work}), WINDOW))
    assert found["contact_loss"] == pytest.approx(0.03)


def test_overlaps_of_a_mixture_are_over_the_smallest_diameter():
    grains = SPHERE.model_copy(update={"count": N, "kinds": MIXED})
    assert numbers(MEASURE.evaluate(by_hand(grains), WINDOW))["max_overlap"] == pytest.approx(0.06)


def test_means_of_a_clogged_run_are_kept_apart():
    found = numbers(MEASURE.evaluate(replace(by_hand(), outcome="clogged"), WINDOW))
    assert set(found) == {"max_overlap", "mean_max_overlap_flowing", "contact_loss_flowing"}
    assert set(found) < {one.name for one in MEASURE.quantities(by_hand().scene)}


def test_what_cannot_be_measured_is_told():
    run = by_hand()
    with pytest.raises(MeasureError, match="run it again"):
        MEASURE.evaluate(replace(run, tables={"crossing": run.tables["crossing"]}), WINDOW)
    seldom = {name: column[::20] for name, column in run.tables["ledger"].items()}
    largest, mean, loss = MEASURE.evaluate(by_hand(changed=seldom), WINDOW).numbers
    assert largest.value == pytest.approx(0.02)
    assert math.isnan(mean.value)
    assert math.isnan(loss.value)
    assert "only 4 sampled steps" in mean.note
    few = MEASURE.evaluate(run, Window(start=0.1, end=0.12)).numbers
    assert "too few grains" in few[1].note
    none = {name: column[:0] for name, column in run.tables["ledger"].items()}
    largest, *_ = MEASURE.evaluate(by_hand(changed=none), WINDOW).numbers
    assert math.isnan(largest.value)
    assert "before the first sample" in largest.note


def test_a_closed_scene_has_overlaps_only():
    closed = linear(SPHERE, Box(width=0.1, depth=0.1, height=0.1))
    assert [one.name for one in MEASURE.quantities(closed)] == ["max_overlap"]
    assert MEASURE.probes(closed, Numerics(dt=1e-5, steps_per_beat=100)) == (Ledger(every=8),)  # 8 ms
    run = replace(by_hand(), scene=closed, tables={"ledger": by_hand().tables["ledger"]})
    assert set(numbers(MEASURE.evaluate(run, WINDOW))) == {"max_overlap"}


def test_some_hundred_rows_and_few_intervals_in_a_sweep():
    numerics, found = Numerics(dt=2e-6, steps_per_beat=100), set()
    for width in np.linspace(0.02, 0.03, 11):
        grains = SPHERE.model_copy(update={"count": 3000})
        scene = linear(grains, HOPPER.model_copy(update={"orifice": float(width)}))
        crossing, ledger = MEASURE.probes(scene, numerics)
        assert crossing == Crossing(0.0)
        assert isinstance(ledger, Ledger)
        flow = 0.58 * 2500 * math.sqrt(G) * (width - 1.5 * D) ** 1.5 * HOPPER.thickness  # Beverloo's law
        rows = grains.count * grains.mass / flow / (ledger.every * numerics.beat)
        assert 100 <= rows <= 260
        found.add(ledger.every)
    assert len(found) <= 2
    coarse = MEASURE.probes(by_hand().scene, Numerics(dt=1e-5, steps_per_beat=10_000))
    assert coarse == (Crossing(0.0), Ledger(every=1))


def motion(platform: Bundled, scene: Scene, start: Packing, dt: float, steps: int) -> tuple[Evaluation, np.ndarray]:
    """What the measure finds of a motion of which every step is sampled, and the times [s]."""
    numerics = platform.numerics(dt, steps_per_beat=1)
    rows = platform.run(MemberStart(scene, dt, start), steps, 1, [Ledger()]).rows(Ledger())
    run = RunData(scene, numerics, 1, start, "time-limit", steps * dt, {"ledger": rows})
    found = MEASURE.evaluate(run, WINDOW)
    return found, found.arrays["time"]


on_every_stand = pytest.mark.parametrize(
    "platform", [where(sharing(one), pytest.mark.compiles, once=True) for one in platforms()]
)


@on_every_stand
def test_a_grain_at_rest_overlaps_with_the_floor_by_its_weight(platform):
    scene = linear(SPHERE, Primitives(parts=(floor(),)), restitution=0.5)
    overlap = SPHERE.mass * G / K
    found, _ = motion(platform, scene, grains_at([0, 0, D / 2 - overlap]), 1e-6, 200)
    # it is there from the start; single precision rounds forces
    assert found.arrays["max_overlap"] == pytest.approx(overlap / D, rel=1e-6)
    assert abs(found.arrays["contact_work"]).max() < 1e-9 * SPHERE.mass * G * D


@on_every_stand
def test_the_heaviest_of_two_kinds_overlaps_most(platform):
    """By Hertz, m g = 4/3 E* sqrt(R) overlap^1.5. Other tests of mixtures have this law, too, and share its kernels."""
    grains, law = SPHERE.model_copy(update={"count": 2, "kinds": MIXED}), hertz(shear_modulus=2e6)
    scene = Scene(grains=grains, contact=law, container=Primitives(parts=(floor(),)), gravity=G)
    mass = np.array([2500 * D**3, 7800 * (D / 3) ** 3]) * math.pi / 6
    radius = np.array([D / 2, D / 6])
    overlap = (mass * G / (4 / 3 * 2e6 / (1 - law.poisson_ratio) * np.sqrt(radius))) ** (2 / 3)
    at = np.column_stack([[0, 0.02], [0, 0], radius - overlap])
    start = replace(grains_at(at), kind=np.array([0, 1]), diameter=2 * radius)
    found, _ = motion(platform, scene, start, 1e-6, 50)
    assert found.arrays["max_overlap"] == pytest.approx(overlap[0] / (D / 3), rel=1e-6)


@on_every_stand
def test_a_rod_that_lies_overlaps_with_half_its_weight_at_either_end(platform):
    scene = linear(ROD, Primitives(parts=(floor(),)), restitution=0.5)
    overlap = ROD.mass * G / (2 * K)
    lies = [math.sqrt(0.5), 0, math.sqrt(0.5), 0]  # a quarter turn about y
    found, _ = motion(platform, scene, rods_at([[0, 0, ROD.radius - overlap]], [lies]), 1e-6, 50)
    # the quaternion is rounded, which tilts the rod by some 1e-16 of its length
    assert found.arrays["max_overlap"] == pytest.approx(overlap / ROD.diameter, rel=1e-6)


@on_every_stand
def test_largest_overlap_of_a_collision(platform):
    """v sqrt(m_eff/k), of linear springs without damping."""
    grains, v = SPHERE.model_copy(update={"count": 2}), 0.1
    scene, effective = linear(grains, room(), gravity=0.0), SPHERE.mass / 2
    dt = math.pi * math.sqrt(effective / K) / 400
    apart = D / 2 + 0.5 * v * dt
    start = grains_at([[-apart, 0, 0.5], [apart, 0, 0.5]], [[v / 2, 0, 0], [-v / 2, 0, 0]])
    found, _ = motion(platform, scene, start, dt, 420)
    deepest = v * math.sqrt(effective / K)
    # the steps before and after the turn miss it by up to (w dt/2)^2/2, the integrator by as much: 1.5e-5
    assert numbers(found)["max_overlap"] == pytest.approx(deepest / D, rel=3e-5)
    # half way they stand still, and what contacts took is given back
    start_energy = SPHERE.mass * (v / 2) ** 2
    assert found.arrays["contact_work"].min() == pytest.approx(-start_energy, rel=1e-4)
    assert abs(found.arrays["contact_work"][-1]) < 1e-4 * start_energy
    assert found.arrays["kinetic"] - found.arrays["contact_work"] == pytest.approx(start_energy, rel=1e-4)


@on_every_stand
@pytest.mark.parametrize("shape", ["sphere", "rod"])
def test_energies_of_a_free_fall(platform, shape):
    grains = SPHERE if shape == "sphere" else ROD
    scene = linear(grains, Primitives(parts=(floor(),)))
    start = grains_at([0, 0, 0.5]) if shape == "sphere" else rods_at([[0, 0, 0.5]], [[1, 0, 0, 0]])
    found, time = motion(platform, scene, start, 1e-4, 200)
    fallen = grains.mass * G * G * time**2 / 2
    # velocities grow evenly, so that a leapfrog makes no error in them; in single they round at each step
    rounding = 1e-9 if platform.precision == "double" else 1e-5
    assert found.arrays["kinetic"] == pytest.approx(fallen, rel=rounding)
    assert found.arrays["potential"] == pytest.approx(grains.mass * G * 0.5 - fallen, rel=rounding)
    # the work is what is left of the gain in energy less the work of gravity, each of which is rounded
    assert abs(found.arrays["contact_work"]).max() < rounding * fallen[-1]
    assert numbers(found)["max_overlap"] == 0


SMALL = """
name: small
grains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 400}
contact: {law: hertz-mindlin, shear_modulus: 5 MPa, poisson_ratio: 0.25, friction: 0.5, rolling_friction: 0.01,
  restitution: 0.2}
container: {kind: wedge-hopper, width: 45 mm, height: 200 mm, thickness: 1.01 d, orifice: 20 mm}
numerics: {steps_per_beat: 200}
measure: [flow_rate, ledger]
"""


@pytest.fixture(scope="module")
def discharge(tmp_path_factory) -> RunData:
    """A discharge on the CPU backend, as it is kept in a lab."""
    numba = pytest.importorskip("labbook_numba")
    folder = tmp_path_factory.mktemp("small")
    (folder / "small.yaml").write_text(SMALL)
    asked = load(folder / "small.yaml")
    summary = Runner(asked, LabFolder(folder / "lab"), numba.Backend(wide=True)).run()
    assert list(summary.tally.ran.values()) == ["finished"], summary.tally.failed
    (kept,) = (folder / "lab/runs").iterdir()
    assert (kept / "ledger.npz").is_file()
    assert list(kept.glob(f"{EVALUATION}*ledger*"))
    return open_run(kept)[1]


@pytest.mark.compiles
def test_overlaps_of_a_discharge_are_as_foreseen(discharge):
    found = numbers(MEASURE.evaluate(discharge, Window()))
    law, grains = discharge.scene.contact, discharge.scene.grains
    assert isinstance(law, HertzMindlin)
    height = float(discharge.start.x[:, 2].max())
    pressure = PACKED * grains.mean_density * G * height
    foreseen = (1.5 * pressure / law.effective_modulus) ** (2 / 3)
    # foreseen is the mean contact at the foot of the bed at rest; the deepest of a thousand bears some times its load
    assert 1 < found["mean_max_overlap"] / foreseen < 5
    assert found["mean_max_overlap"] < found["max_overlap"] < 10 * foreseen


@pytest.mark.compiles
def test_energy_of_a_discharge_adds_up(discharge):
    found = MEASURE.evaluate(discharge, Window())
    rows, grains = found.arrays, discharge.scene.grains
    energy = rows["kinetic"] + rows["potential"]
    whole = rows["grains"] == grains.count
    assert whole.sum() > 5
    # until a grain is dropped; a row is read half a kick after the work was counted, which is of second order
    closed = (energy - rows["contact_work"])[whole]
    assert np.ptp(closed) < 1e-6 * energy[0]
    # later, grains take along what they had when they crossed the outlet, but for the contacts that they have below it
    left = discharge.tables["crossing"]
    v2, w2 = (sum(left[part + axis] ** 2 for axis in "xyz") for part in "vw")
    each = grains.mass * (v2 / 2 + G * left["z"]) + grains.inertia * w2 / 2
    taken = np.concatenate([[0.0], np.cumsum(each[np.argsort(left["time"])])])[grains.count - rows["grains"]]
    spent = closed[0] - energy - taken
    assert -rows["contact_work"][-1] == pytest.approx(spent[-1], rel=0.02)


def test_a_lab_without_it_runs_again_what_lacks_it_and_keeps_its_keys(tmp_path):
    def planned(asked):
        return Planner(asked, Catalogue(lab), Toy().capabilities).plan()

    lab, before = tmp_path / "lab", study(tmp_path, replicates=1)
    carry_out(before, lab)
    keys = {item.keys.run for item in planned(before).items}
    path = Path(tmp_path / "toy.yaml")
    one = path.read_text().replace("[18, 24]", "[24]").replace("[flow_rate]", "[flow_rate, ledger]")
    path.write_text(one)
    carry_out(load(path), lab)
    path.write_text(one.replace("[24]", "[18, 24]"))
    made = planned(load(path))
    assert {item.keys.run for item in made.items} == keys
    assert [item.state for item in made.items] == ["partial", "done"]
    assert made.items[0].reason.startswith("not observed: ")
    assert '"kind":"ledger"' in made.items[0].reason
    summary = carry_out(load(path), lab)
    assert len(summary.tally.ran) == 1
    assert {item.state for item in planned(before).items} == {"done"}, "whoever asks for less has it"
