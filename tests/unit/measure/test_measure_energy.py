"""Energy balance: of a discharge made by hand, and of one by the CPU backend, whose terms add up."""

import math
from dataclasses import replace

import numpy as np
import pytest
from toy_results import analyse

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Dissipation, Ledger, columns
from labbook.lab import Catalogue, LabFolder
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.plan.coverage import finished
from labbook.run.runner import Runner
from labbook.scene import HertzMindlin, Packing, Scene, Spheres, Spherocylinders, WedgeHopper
from labbook.scene.feed import Feed
from labbook.study import define
from labbook.study.schema import Window

MEASURE = MEASURES["energy"]
D, N, RATE, G, SPEED = 3e-3, 1000, 500.0, 9.81, 0.4
MASS = 2500 * math.pi / 6 * D**3
HEIGHT = 0.1
WINDOW = Window(start=0.1, end=0.5)
WHOLE = ("power_released", "power_carried", "power_contacts", "power_rest")
TERMS = (*WHOLE, "power_normal", "power_friction", "power_rolling")


def by_hand(followed: bool) -> RunData:
    """Grains leave from HEIGHT, RATE a second, with SPEED; the bed is at rest. `followed`: for 20 ms after they left
    the backend still has them."""
    time = 0.01 * np.arange(1, 121)
    table = {name: np.zeros(len(time), kind) for name, kind in columns(Ledger()).items()}
    left = np.arange(1, 601) / RATE
    kept = 0.02 if followed else 0.0
    for k, t in enumerate(time):
        fall = t - left[(left <= t) & (left > t - kept)]
        inside = N - (left <= t).sum()
        table["grains"][k] = inside + len(fall)
        table["kinetic"][k] = 0.5 * MASS * ((SPEED + G * fall) ** 2).sum()
        table["potential"][k] = MASS * G * (inside * HEIGHT - (SPEED * fall + G / 2 * fall**2).sum())
    table["time"], table["contact_work"] = time, -9e-4 * time
    powers = {"time": time, "normal_power": 0 * time + 3e-4, "tangential_power": 4e-4 + 1e-4 * np.sin(40 * time)}
    powers |= {"wall_power": 0 * time, "elastic": 0 * time + 1e-6}
    zero = np.zeros(600)
    crossing = {"time": left, "id": np.arange(600), "vz": zero - SPEED}
    crossing |= dict.fromkeys(("x", "y", "z", "vx", "vy", "wx", "wy", "wz"), zero)
    scene = Scene(
        grains=Spheres(diameter=D, density=2500, count=N),
        contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25),
        container=WedgeHopper(width=0.06, height=0.3, thickness=1.01 * D, orifice=0.024),
        gravity=G,
    )
    start = Packing(x=np.zeros((N, 3)), v=np.zeros((N, 3)), omega=np.zeros((N, 3)))
    tables = {"crossing": crossing, "ledger": table, "dissipation": powers}
    return RunData(scene, Numerics(dt=1e-5), 1, start, "finished", 1.2, tables)


@pytest.mark.parametrize("followed", [False, True])
def test_terms_of_a_discharge_by_hand(followed):
    """Grains that are still followed below the outlet change no term."""
    found = {one.quantity: one for one in MEASURE.evaluate(by_hand(followed), WINDOW).numbers}
    released, carried = RATE * MASS * G * HEIGHT, RATE * 0.5 * MASS * SPEED**2
    assert found["power_released"].value == pytest.approx(released, rel=1e-9)
    assert found["power_carried"].value == pytest.approx(carried, rel=1e-9)
    assert found["power_normal"].value == pytest.approx(3e-4)
    time = by_hand(followed).tables["ledger"]["time"]
    inside = (time >= 0.2) & (time <= 1.0)
    friction = 4e-4 + 1e-4 * np.sin(40 * time[inside]).mean()
    assert found["power_friction"].value == pytest.approx(friction)
    assert found["power_contacts"].value == pytest.approx(9e-4)
    assert found["power_rest"].value == pytest.approx(released - carried - 9e-4)
    assert found["power_rolling"].value == pytest.approx(9e-4 - 3e-4 - friction)
    assert found["power_rolling"].error == found["power_friction"].error > 0
    assert found["elastic_energy"].value == pytest.approx(1e-6)


def test_clogged_runs_and_runs_without_samples():
    clogged = replace(by_hand(True), outcome="clogged")
    names = {one.quantity for one in MEASURE.evaluate(clogged, WINDOW).numbers}
    assert names == {f"{name}_flowing" for name in (*TERMS, "elastic_energy")}
    seldom = by_hand(True)
    few = {name: column[::20] for name, column in seldom.tables["dissipation"].items()}
    found = MEASURE.evaluate(replace(seldom, tables={**seldom.tables, "dissipation": few}), WINDOW).numbers
    assert all(math.isnan(one.value) and "steps_per_beat" in one.note for one in found)
    with pytest.raises(MeasureError, match="run it again"):
        MEASURE.evaluate(replace(seldom, tables={"crossing": seldom.tables["crossing"]}), WINDOW)


def test_rods_carry_the_energy_of_their_spin_and_their_dissipation_is_not_split():
    """Each leaves with a spin of 30 rad/s about its axis, which points up, and 20 rad/s across it."""
    rods, spheres = Spherocylinders(diameter=D, length=2 * D, density=2500, count=N), by_hand(False)
    turned = {"qw": np.ones(600)} | dict.fromkeys(("qx", "qy", "qz"), np.zeros(600))
    spin = {"wz": np.full(600, 30.0), "wx": np.full(600, 20.0)}
    q, ledger = np.tile([1.0, 0.0, 0.0, 0.0], (N, 1)), spheres.tables["ledger"]
    run = replace(
        spheres,
        scene=spheres.scene.model_copy(update={"grains": rods}),
        start=replace(spheres.start, q=q),
        tables={
            "crossing": {**spheres.tables["crossing"], **turned, **spin},
            "ledger": {**ledger, "potential": ledger["potential"] * rods.mass / MASS},
        },
    )
    found = {one.quantity: one.value for one in MEASURE.evaluate(run, WINDOW).numbers}
    assert tuple(found) == WHOLE
    each = 0.5 * (rods.mass * SPEED**2 + rods.inertia_axis * 30.0**2 + rods.inertia * 20.0**2)
    assert found["power_carried"] == pytest.approx(RATE * each, rel=1e-9)
    assert found["power_released"] == pytest.approx(RATE * rods.mass * G * HEIGHT, rel=1e-9)
    assert found["power_rest"] == pytest.approx(found["power_released"] - RATE * each - 9e-4)
    probes = MEASURE.probes(run.scene, Numerics(dt=1e-5, steps_per_beat=100))
    assert not any(isinstance(probe, Dissipation) for probe in probes)


def test_it_is_of_a_discharge():
    scene = by_hand(True).scene
    crossing, ledger, power = MEASURE.probes(scene, Numerics(dt=1e-5, steps_per_beat=100))
    assert isinstance(crossing, Crossing)
    assert isinstance(ledger, Ledger)
    assert power == Dissipation(every=ledger.every)
    with pytest.raises(MeasureError, match="is fed"):
        MEASURE.check(scene.model_copy(update={"feed": Feed(kind="reinject")}))


@pytest.mark.slow
@pytest.mark.compiles
def test_the_terms_of_a_discharge_add_up(tmp_path):
    """The balance closes to the order of the step; without rolling friction nothing is left of the work of contacts,
    which kernels add up at every step, but the error of sampling."""
    numba = pytest.importorskip("labbook_numba")
    asked = define(
        name="energy",
        grains={"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 250},
        contact={"law": "hertz-mindlin", "shear_modulus": "1 MPa", "poisson_ratio": 0.25, "friction": 0.5}
        | {"restitution": 0.4, "rolling_friction": 0.0},
        container={"kind": "wedge-hopper", "width": "40 mm", "height": "120 mm", "thickness": "1.01 d"}
        | {"orifice": "20 mm"},
        numerics={"dt": "20 us", "steps_per_beat": 20},
        window={"start": 0.15, "end": 0.6},
        measure=["flow_rate", "energy", "ledger"],
    )
    Runner(asked, LabFolder(tmp_path), numba.Backend(wide=True)).run()
    (point,) = analyse(asked, finished(Catalogue(tmp_path), asked, "numba")).points
    found = point.runs[0].measured
    value = {name: found[name].value for name in (*TERMS, "contact_loss")}
    assert all(value[name] > 0 for name in ("power_normal", "power_friction", *WHOLE[:3]))
    assert abs(value["power_rest"]) < 1e-2 * value["power_released"]
    assert abs(value["power_rolling"]) < 3 * found["power_rolling"].error
    # some fifty samples of powers that scatter by half their mean
    assert value["power_normal"] + value["power_friction"] == pytest.approx(value["contact_loss"], rel=0.1)
