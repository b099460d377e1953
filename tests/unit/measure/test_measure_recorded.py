"""What recorded frames show of how a bed flows, of made-up motions."""

import math

import numpy as np
import pytest

from labbook.backend.numerics import Numerics
from labbook.measure import MEASURES, RunData
from labbook.measure.recorded import Bed, FlowPattern, KindPatterns
from labbook.scene import CylinderSilo, HertzMindlin, Packing, Scene, Spheres
from labbook.scene.grains import Kind

LAW = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25)
D = 3e-3


class Window:
    start, end, timed = 0.05, 0.45, False


def silo(count: int = 4000, **grains) -> Scene:
    container = CylinderSilo(diameter=0.06, height=0.4, orifice=0.03)
    return Scene(grains=Spheres(diameter=D, density=2500, count=count, **grains), contact=LAW, container=container)


def lattice(spacing: float) -> np.ndarray:
    side = np.arange(-0.03, 0.03, spacing)
    x = np.array([(a, b, c) for a in side for b in side for c in np.arange(-0.02, 0.06, spacing)])
    return x[np.hypot(x[:, 0], x[:, 1]) < 0.028]


def table_of(x: np.ndarray, times: np.ndarray, vz: np.ndarray) -> dict[str, np.ndarray]:
    """Grains at x whose velocities vz, shape [frames, n], alone change."""
    n, frames = len(x), len(times)
    made = {"step": np.repeat(np.arange(frames), n), "time": np.repeat(times, n), "id": np.tile(np.arange(n), frames)}
    made |= {axis: np.tile(x[:, k], frames) for k, axis in enumerate("xyz")}
    return made | {"vx": np.zeros(n * frames), "vy": np.zeros(n * frames), "vz": np.ravel(vz)}


def run_of(scene: Scene, table: dict[str, np.ndarray], crossings: np.ndarray, start: Packing | None = None) -> RunData:
    n = scene.grains.count
    start = start or Packing(*np.zeros((3, n, 3)))
    tables = {"crossing": {"id": np.arange(len(crossings)), "time": crossings}, "zone": table}
    return RunData(scene, Numerics(dt=1e-6), 1, start, "finished", 5.0, tables, lambda: table)


def numbers(measure, run: RunData) -> dict[str, float]:
    return {one.quantity: one.value for one in measure.evaluate(run, Window()).numbers}


def test_gaps_without_flow_are_left_out_as_of_the_flow_rate():
    """A plug sinks at 0.2 m/s, stands still for three seconds, and sinks again."""
    times, x = np.arange(0, 5, 0.05), lattice(0.0035)
    flows = (times < 1) | (times >= 4)
    table = table_of(x, times, np.where(flows, -0.2, 0.0)[:, None] * np.ones(len(x)))
    run = run_of(silo(), table, np.concatenate([np.arange(0.01, 1, 0.001), np.arange(4, 5, 0.001)]))
    of_pattern, of_orifice = numbers(FlowPattern(), run), numbers(MEASURES["orifice"], run)
    assert of_pattern["orifice.v_z"] == pytest.approx(-0.2, rel=1e-9)
    assert of_pattern["orifice.v_z"] == pytest.approx(of_orifice["orifice_v_z"], rel=1e-9)
    assert of_pattern["orifice.kinetic_pressure"] == pytest.approx(0, abs=1e-9)


def test_grains_of_a_mixture_count_by_their_own_mass_and_volume():
    """Large grains that sink at 0.1 m/s, between small ones at 0.5 m/s."""
    spacing = 3.2e-3
    x, times = lattice(spacing), np.arange(0, 1, 0.04)
    large = np.random.default_rng(1).random(len(x)) < 0.5
    kinds = (Kind(name="large", share=0.5), Kind(name="small", share=0.5, diameter=1e-3))
    scene, nowhere = silo(len(x), kinds=kinds), np.zeros((3, len(x), 3))
    start = Packing(*nowhere, diameter=np.where(large, D, 1e-3), kind=(~large).astype(int))
    table = table_of(x, times, np.tile(np.where(large, -0.1, -0.5), (len(times), 1)))
    found = numbers(FlowPattern(), run_of(scene, table, np.arange(0.001, 1, 0.0002), start))
    mean = math.pi / 6 * (D**3 + 1e-9) / 2 / spacing**3
    assert found["orifice.packing_fraction"] == pytest.approx(mean, rel=0.06)
    assert found["orifice.v_z"] == pytest.approx(-(0.1 * 27 + 0.5) / 28, rel=0.06)


def test_fields_of_the_kinds_add_up_to_those_of_all():
    """Large grains that sink at 0.1 m/s, between small ones at 0.5 m/s, on the same grid."""
    x, times = lattice(3.2e-3), np.arange(0, 1, 0.04)
    large = np.random.default_rng(1).random(len(x)) < 0.5
    kinds = (Kind(name="large", share=0.5), Kind(name="small", share=0.5, diameter=1e-3))
    start = Packing(*np.zeros((3, len(x), 3)), diameter=np.where(large, D, 1e-3), kind=(~large).astype(int))
    table = table_of(x, times, np.tile(np.where(large, -0.1, -0.5), (len(times), 1)))
    run = run_of(silo(len(x), kinds=kinds), table, np.arange(0.001, 1, 0.0002), start)
    whole, of_kinds = Bed.of(FlowPattern().evaluate(run, Window())), KindPatterns().evaluate(run, Window())
    parts = [Bed.of(of_kinds, name) for name in ("large", "small")]
    assert whole is not None
    fields = [bed.fields for bed in parts if bed is not None]
    assert [bed.grid for bed in fields] == [whole.fields.grid] * 2
    density = fields[0].density + fields[1].density
    assert density == pytest.approx(whole.fields.density, rel=1e-9)
    for bed, speed in zip(fields, (-0.1, -0.5), strict=True):
        filled = bed.density > 0.01 * bed.density.max()
        assert bed.velocity[2][filled] == pytest.approx(np.full(filled.sum(), speed), rel=1e-6)
    assert KindPatterns().evaluate(run_of(silo(len(x)), table, np.arange(0.001, 1, 0.0002)), Window()).arrays == {}
