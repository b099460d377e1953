"""What `labbook plan` foresees: time by device, steps, the height of beds, and what it warns of."""

import json
import math
import re
from pathlib import Path

import labbook_toy
import numpy as np
import pytest
from toy_lab import STUDY, labbook, study_file

from labbook.backend import Device, Survey, Unsupported
from labbook.backend.machine import Pace
from labbook.filling.bed import PACKED, expected_bed_height
from labbook.lab import Catalogue
from labbook.measure import MEASURES
from labbook.measure.region import bulk, bulk_below
from labbook.plan import forecast
from labbook.plan.advice import RING, SOFT, advice, foresee, forewarn, limits, softer, too_large
from labbook.plan.demand import PointDemand
from labbook.plan.forecast import DEFAULT_SPEED, MEASURED, outline, rate_of
from labbook.plan.plan import Planner
from labbook.plan.possible import check
from labbook.scene import (
    Box,
    ConicalSilo,
    CylinderSilo,
    HertzMindlin,
    LinearSpringDashpot,
    Packing,
    Primitives,
    Scene,
    Spheres,
    Spherocylinders,
    WedgeHopper,
)
from labbook.scene.timescales import largest_stable_step
from labbook.study import load

RESULTS = Path(__file__).parents[3] / "benchmarks/results"
LAW = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25)


@pytest.fixture(autouse=True)
def pace(monkeypatch):
    """Cores as fast as those of the reference, and idle: no test measures the machine. Returns a setter of another
    pace, which also keeps the numbers of threads that were measured."""
    threads: list[int] = []

    def set_pace(core: float, share: float) -> list[int]:
        monkeypatch.setattr(forecast, "pace", lambda lanes: threads.append(lanes) or Pace(core, share))
        return threads

    set_pace(1.0, 1.0)
    return set_pace


def backend_of(name: str, **more):
    """The toy backend under another name, which its speeds are looked up by."""
    return type("Named", (labbook_toy.Backend,), {"NAME": name, **more})()


def planned(tmp_path, name="toy", beat=200, more=(), **changes):
    """beat: steps of one."""
    backend, lab = backend_of(name), Catalogue(tmp_path / "lab")
    path = study_file(tmp_path, *more, **changes)
    path.write_text(path.read_text().replace("steps_per_beat: 200", f"steps_per_beat: {beat}"))
    return Planner(load(path), lab, backend.capabilities).plan(), lab, backend


TIMINGS = {}
for _one in json.loads((RESULTS / "2026-11-22-batch-warp-h200.json").read_text())["timings"]:
    TIMINGS.setdefault((_one["scene"], _one["members"], _one["precision"]), _one)
"""With the backend's own number of threads a grain; later ones of the same name vary that."""


@pytest.mark.parametrize("timing", TIMINGS.values(), ids=map(str, TIMINGS))
def test_steps_on_a_gpu_cost_what_was_measured(timing):
    """Within 45 %: one line in the grains, for scenes of different walls and 3 thousand to 3 million grains."""
    shape = "spherocylinder" if timing["scene"] == "rods" else "sphere"
    rate = rate_of("warp", "cuda:0", shape, timing["precision"])
    step = rate.step + rate.grain * timing["grains"] * timing["members"]
    assert step == pytest.approx(timing["step"] * 1e-6, rel=0.45)


def test_steps_on_a_core_cost_what_was_measured():
    """The median of what was measured with 2000 to 10 000 grains, within 25 %; with 100 000, within 20 %."""
    found = json.loads((RESULTS / "2026-11-22-backend-numba-loaded.json").read_text())["rates"]
    for one in (one for one in found if one["grains"] <= 10_000):
        shape = "spherocylinder" if one["case"].startswith("rods") else "sphere"
        rate = MEASURED["numba", "cpu", shape, one["precision"], True]
        assert 1e-6 / rate.of(one["grains"]) == pytest.approx(one["median"], rel=0.25)
    (large,) = (one["median"] for one in found if one["grains"] == 100_000)
    assert 1e-6 / MEASURED["numba", "cpu", "sphere", "double", True].of(100_000) == pytest.approx(large, rel=0.2)


def test_replicates_on_a_gpu_go_on_side_by_side(tmp_path):
    """Of 5e6 grain-steps a second, as on one core of an unknown backend, they would take a thousand times as long."""
    made, lab, backend = planned(tmp_path, "warp", beat=50_000, count=3000, replicates=40)
    ahead = forecast.forecast(made, lab, "none", "cuda:0", 1, backend)
    assert ahead.seconds - ahead.compiling < 2 * 60 * 200e3 * 1e-6
    assert ahead.grain_steps / DEFAULT_SPEED > 100 * ahead.seconds
    assert "H200" in ahead.basis
    alone = forecast.forecast(made, lab, "none", "cuda:0", 1, backend, members=1)
    assert alone.seconds > 3 * ahead.seconds


def test_the_host_reads_every_probe_of_every_member_at_each_beat(tmp_path):
    """Beside an H100, 24 runs of a hopper with profiles, 8 of them recorded, took 116 s; their steps alone 24 s."""
    every = (1000, 2000, 4000)
    plans = [planned(tmp_path, "warp", beat=beat, replicates=20) for beat in every]
    one, two, four = (
        forecast.forecast(made, lab, "none", "cuda:0", 1, backend).seconds for made, lab, backend in plans
    )
    assert one - two == pytest.approx(2 * (two - four))
    made, *_ = plans[0]
    beats = sum(forecast.discharge_time(item.demand.shared) / item.demand.shared.numerics.beat for item in made.todo)
    assert 2 * (one - two) > 1.4e-3 * beats


def test_a_recorded_replicate_goes_on_beside_the_others(tmp_path):
    one, two = (
        forecast.forecast(made, lab, "none", "cuda:0", 1, backend)
        for made, lab, backend in (
            planned(tmp_path, "warp", beat=100_000, replicates=4),
            planned(tmp_path, "warp", beat=100_000, replicates=4, more=["record: {every: 10 s, replicates: 1}"]),
        )
    )
    assert (one.sets, two.sets) == (2, 2)
    assert 1 <= (two.seconds - two.compiling) / (one.seconds - one.compiling) < 1.1


def test_compiling_counts_once_for_every_set_of_features(tmp_path, monkeypatch):
    monkeypatch.setattr(forecast, "wide_vectors", lambda: True)
    made, lab, backend = planned(tmp_path, "numba")
    ahead = forecast.forecast(made, lab, "none", "cpu", 2, backend)
    filling_and_discharge = 2
    assert (ahead.sets, ahead.compiling) == (filling_and_discharge, 2 * 9)
    assert ahead.seconds > ahead.compiling
    assert forecast.forecast(made, lab, "none", "cpu", 2).compiling == 0


def test_a_forecast_without_runs_is_at_the_present_speed_of_the_cores(tmp_path, pace):
    """Half as fast as the reference, and a fifth of a core for each lane: everything takes ten times as long."""
    made, lab, backend = planned(tmp_path, "numba")
    reference = forecast.forecast(made, lab, "none", "cpu", 2, backend)
    threads = pace(0.5, 0.2)
    ahead = forecast.forecast(made, lab, "none", "cpu", 2, backend)
    assert ahead.seconds == pytest.approx(10 * reference.seconds)
    assert ahead.compiling == pytest.approx(10 * reference.compiling)
    assert ahead.speed == pytest.approx(reference.speed / 10)
    wanted = "times 0.1, measured now: a core is 0.5 times as fast, and each of 2 workers gets 20 % of one"
    assert wanted in ahead.basis
    alone = forecast.forecast(made, lab, "none", "cpu", 1, backend)
    assert "the worker gets 20 %" in alone.basis
    assert set(threads) == {1, 2}


def test_the_cores_are_not_measured_without_need(tmp_path, pace, monkeypatch):
    """Neither where runs of the lab tell the speed, nor for warnings, nor of a backend of unknown speed."""
    threads = pace(0.5, 0.2)
    made, lab, backend = planned(tmp_path, "numba", count=1000)
    forewarn(made.study, lab, backend, "cpu")
    forecast.forecast(*planned(tmp_path)[:2], "none", "cpu", 2)
    monkeypatch.setattr(lab, "speeds", lambda *_: [("any", 1000, 1e7)])
    monkeypatch.setattr(forecast._Speeds, "_shape", lambda *_: "sphere")
    assert forecast.forecast(made, lab, "here", "cpu", 1, backend).speed == pytest.approx(1e7)
    assert threads == []
    monkeypatch.undo()
    pace(0.5, 0.2)
    ahead = foresee(made.study, lab, backend, "cpu").forecast
    assert ahead is not None
    assert "measured now" in ahead.basis


def test_a_forecast_on_a_gpu_is_at_its_present_bandwidth(tmp_path):
    """At half the copy bandwidth of the reference the grains of a large scene take twice as long; starts do not."""
    timed = []
    for copies in (None, 2.0e12):
        made, lab, _ = planned(tmp_path, "warp", beat=50_000, count=1_000_000, replicates=1)
        backend = backend_of("warp", bandwidth=lambda self, device, copies=copies: copies)
        timed.append(forecast.forecast(made, lab, "none", "cuda:0", 1, backend))
    known, slow = timed
    starts = 0.05  # 5 us a step of 135 us
    assert (slow.seconds - slow.compiling) / (known.seconds - known.compiling) == pytest.approx(2, rel=starts)
    assert "times 0.5, measured now" in slow.basis
    assert "measured" not in known.basis


def test_code_that_is_cached_is_not_foreseen_to_be_compiled(tmp_path):
    made, lab, _ = planned(tmp_path, "numba")
    backend = backend_of("numba", compiled=lambda self, spec: True)
    ahead = forecast.forecast(made, lab, "none", "cpu", 2, backend)
    assert (ahead.sets, ahead.compiling) == (0, 0)


def test_no_more_lanes_help_than_the_longest_run_lets(tmp_path):
    made, lab, backend = planned(tmp_path, replicates=1, orifices="[18]")
    one, many = (forecast.forecast(made, lab, "none", "cpu", lanes, backend).seconds for lanes in (1, 64))
    assert one == pytest.approx(many)


def test_speeds_of_other_shapes_do_not_count(tmp_path):
    """Runs of spheres in the lab say nothing of rods."""
    path, lab = study_file(tmp_path), tmp_path / "lab"
    labbook("run", path, "--lab", lab, "--backend", "toy")
    text = path.read_text()
    spheres = json.loads(labbook("plan", path, "--lab", lab, "--backend", "toy", "--json").output)
    path.write_text(text.replace("replicates: 2", "replicates: 3"))
    spheres = json.loads(labbook("plan", path, "--lab", lab, "--backend", "toy", "--json").output)
    path.write_text(text.replace("sphere, diameter", "spherocylinder, length: 6 mm, diameter"))
    rods = json.loads(labbook("plan", path, "--lab", lab, "--backend", "toy", "--json").output)
    assert "4 runs on this machine" in spheres["forecast"]["basis"]
    assert "assumed" in rods["forecast"]["basis"]


def test_large_runs_of_the_lab_are_forecast_at_the_speed_that_they_had(tmp_path, monkeypatch):
    """Beyond the caches a grain-step is dearer, and the recorded speed of a large run says so already."""
    made, lab, backend = planned(tmp_path, count=100_000)
    monkeypatch.setattr(lab, "speeds", lambda *_: [("any", 100_000, 1e7)])
    monkeypatch.setattr(forecast._Speeds, "_shape", lambda *_: "sphere")
    ahead = forecast.forecast(made, lab, "here", "cpu", 1, backend)
    assert ahead.speed == pytest.approx(1e7)
    small, *_ = planned(tmp_path, count=1000)
    assert forecast.forecast(small, lab, "here", "cpu", 1, backend).speed > 1.5e7


def test_points_that_are_the_same_runs_are_warned_of(tmp_path):
    """A wall that the bed has only while it is filled, with a friction of the filling."""
    more = ("fill: {friction: 0.01}", "points: [{walls.bottom.friction: 0.1}, {walls.bottom.friction: 0.9}]")
    made, *_ = planned(tmp_path, orifices="[24]", more=more)
    (told,) = (line for line in advice(made) if "changes nothing" in line)
    assert "walls.bottom.friction" in told
    assert "walls.bottom.friction 0.1, orifice 24 mm; walls.bottom.friction 0.9, orifice 24 mm" in told
    made, *_ = planned(
        tmp_path, orifices="[24]", more=("points: [{walls.left.friction: 0.1}, {walls.left.friction: 0.9}]",)
    )
    assert not any("changes nothing" in line for line in advice(made))


def test_walls_that_stand_only_while_filling_are_warned_of(tmp_path):
    made, *_ = planned(tmp_path, more=("walls: {bottom: {friction: 0.1}}",))
    (told,) = (line for line in advice(made) if "walls.bottom" in line)
    assert "only while the bed is filled" in told
    assert "use bottom-left, bottom-right" in told
    made, *_ = planned(tmp_path, more=("walls: {all: {friction: 0.1}, bottom-left: {friction: 0.2}}",))
    assert not any("walls." in line for line in advice(made))


def test_runs_of_the_lab_are_missed_only_where_they_would_tell_the_speed(tmp_path):
    """On a GPU they do not: others shared the device with each."""
    made, lab, backend = planned(tmp_path, count=1000)
    assert "this lab has no such run" in forecast.forecast(made, lab, "here", "cpu", 1, backend).basis
    assert "this lab" not in forecast.forecast(made, lab, "here", "cuda:0", 1, backend).basis


def scene(container, grains=None) -> Scene:
    grains = grains or Spheres(diameter=3e-3, density=2500, count=4000)
    return Scene(grains=grains, contact=LAW, container=container)


def test_heights_of_beds():
    volume = 4000 * math.pi / 6 * 27e-9 / PACKED
    flat = WedgeHopper(width=0.1, height=1, thickness=3.1e-3, orifice=0.03)
    assert expected_bed_height(scene(flat)) == pytest.approx(volume / (0.1 * 3.1e-3))
    assert expected_bed_height(scene(CylinderSilo(diameter=0.1, height=1, orifice=0.03))) == pytest.approx(
        volume / (math.pi / 4 * 0.01)
    )
    assert expected_bed_height(scene(Box(width=0.1, depth=0.05, height=1))) == pytest.approx(volume / 0.005)
    assert expected_bed_height(scene(Primitives())) is None


@pytest.mark.parametrize("diameter", [0.06, 1.0])
def test_the_height_of_a_bed_in_a_cone(diameter):
    """Above the cone, and within it: pi/3 ((r + z tan a)^3 - r^3)/tan a below z."""
    silo = ConicalSilo(diameter=diameter, height=2, angle=math.radians(30), orifice=0.02)
    z, slope, volume = expected_bed_height(scene(silo)), math.tan(math.radians(30)), 4000 * math.pi / 6 * 27e-9 / PACKED
    assert z is not None
    cone = min(z, silo.rise)
    inside = math.pi / 3 * ((0.01 + slope * cone) ** 3 - 0.01**3) / slope
    assert inside + math.pi / 4 * diameter**2 * (z - cone) == pytest.approx(volume)
    assert (z > silo.rise) == (diameter == 0.06)


def test_the_height_of_a_bed_in_an_eccentric_wedge():
    """The area below z by quadrature of the width between the plates."""
    from scipy.integrate import quad

    hopper = WedgeHopper(width=0.1, height=1, thickness=3.1e-3, orifice=0.02, angle=math.radians(50), gap=0.01)
    z = expected_bed_height(scene(hopper))
    slope = math.tan(math.radians(50))
    width = lambda h: 0.02 + min(0.01, slope * h) + min(0.07, slope * h)  # noqa: E731
    area = quad(width, 0, z, points=[0.01 / slope, 0.07 / slope])[0]
    assert area * 3.1e-3 == pytest.approx(4000 * math.pi / 6 * 27e-9 / PACKED)


def test_outlets_are_counted_in_the_largest_dimension(tmp_path):
    path = study_file(tmp_path)
    path.write_text(path.read_text().replace("sphere, diameter", "spherocylinder, length: 6 mm, diameter"))
    asked = load(path)
    one = outline(PointDemand(asked, asked.points[0]))
    assert (one.extent, one.ratio) == (0.006, pytest.approx(3))
    assert one.steps * one.dt == pytest.approx(forecast.discharge_time(PointDemand(asked, asked.points[0])))


def test_the_step_is_held_against_the_largest_stable_one_of_what_it_is_used_for(tmp_path):
    path = study_file(tmp_path, "fill: {friction: 5}")
    asked = load(path)
    shared = PointDemand(asked, asked.points[0])
    scenes = [shared.scene, shared.closed]
    assert outline(shared).limit == min(map(largest_stable_step, scenes))
    own = load(study_file(tmp_path, "fill: {numerics: {dt: 5 us}}"))
    shared = PointDemand(own, own.points[0])
    assert outline(shared).limit == largest_stable_step(shared.scene)


@pytest.mark.parametrize(
    "law", [HertzMindlin(shear_modulus=25e9, poisson_ratio=0.25), LinearSpringDashpot(normal_stiffness=1e7)]
)
def test_softer_grains_overlap_by_what_is_said(law):
    """The force p d^2 of the bed's weight, put into the contact law itself."""
    grains, height = Spheres(diameter=3e-3, density=2500, count=1), 0.2
    told = softer(Scene(grains=grains, contact=law, container=Primitives()), height)
    assert told is not None
    (section, _, key), (soft, _, times) = told[0].rpartition("."), told[1:]
    assert section == "contact"
    assert times == pytest.approx(math.sqrt(getattr(law, key) / soft))
    force = PACKED * 2500 * 9.81 * height * 3e-3**2
    overlap = SOFT * 3e-3
    if isinstance(law, HertzMindlin):
        modulus = law.model_copy(update={key: soft}).effective_modulus
        carried = 4 / 3 * modulus * math.sqrt(3e-3 / 4) * overlap**1.5
    else:
        carried = soft * overlap
    assert carried == pytest.approx(force, rel=1e-9)


def test_softer_grains_are_not_asked_of_soft_ones():
    assert (
        softer(
            scene(Primitives()).model_copy(update={"contact": HertzMindlin(shear_modulus=1e6, poisson_ratio=0.25)}), 0.2
        )
        is None
    )


WARNED = [
    ("[18, 24] mm", "[12, 18] mm", "container.orifice", "4 diameters of a grain wide (3 mm), and below 5", "use 15 mm"),
    ("height: 300 mm", "height: 100 mm", "container.height", "grains will stand about 141 mm high", "156 mm high"),
    ("replicates: 2", "replicates: 1", "replicates", "no number has an error", "3 or more"),
    ("[flow_rate]", "[flow_rate]\nfit: [beverloo]", "fit", "2 orifices are too few: beverloo has 2", "sweep 3 or more"),
    ("2 MPa", "25 GPa", "contact.shear_modulus", "times as many steps", "with 1e+07 Pa grains overlap"),
    ("2 MPa", "2 kPa", "contact.shear_modulus", "grains this soft overlap by about", "Pa it is 0.3 % of d"),
]


@pytest.mark.parametrize(("old", "new", "key", "message", "remedy"), WARNED)
def test_each_warning(tmp_path, old, new, key, message, remedy):
    text = STUDY.format(count=1000, orifices="[18, 24]", replicates=2).replace("numerics: {dt: 10 us,", "numerics: {")
    path = tmp_path / "toy.yaml"
    path.write_text(text)
    plain = labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy")
    assert "Warning" not in plain.output
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    told = labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy").output
    (line,) = [line for line in told.splitlines() if line.startswith("Warning")]
    assert line.startswith(f"Warning: {path}: {key}: ")
    assert message in line
    assert remedy in told.splitlines()[told.splitlines().index(line) + 1]


def test_a_window_with_too_few_grains_for_a_flow_rate_is_warned_of(tmp_path):
    def told(count, *more):
        path = study_file(tmp_path, "window: {start: 0.2, end: 0.5}", *more, count=count)
        return labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy").output

    few = told(180)
    assert "grains.count: of 180 grains 54 leave between 20 % and 50 %, and a flow rate needs more than 60" in few
    assert "remedy: use 250 grains or more, or widen window" in few
    assert "needs more than" in told(200)
    assert "needs more than" not in told(210)


def test_an_outlet_that_is_hardly_too_narrow_is_not_said_to_be_as_wide_as_it_should(tmp_path):
    path = study_file(tmp_path, orifices="[14.99]")
    told = labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy").output
    assert "the outlet is 4.997 diameters of a grain wide (3 mm), and below 5 it often clogs" in told


def test_a_ring_of_bottom_of_a_few_grains_is_warned_of(tmp_path):
    """Cylinders of 33 mm, whose ring is 3, 2.75, 2.5 and 2.25 d wide: their W(D) has a step. The width in the remedy is
    not warned of; neither is a cone, nor a study that does not measure W."""
    law = "law: hertz-mindlin, shear_modulus: 5 MPa, poisson_ratio: 0.22, friction: 0.5, restitution: 0.5"

    def told(kind="cylinder-silo", diameter="33", measure="flow_rate", more=""):
        path = tmp_path / "ring.yaml"
        path.write_text(f"""
name: ring
grains: {{shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 2000}}
contact: {{{law}}}
container: {{kind: {kind}, diameter: {diameter} mm, height: 140 mm, orifice: 18 mm{more}}}
sweep: {{container.orifice: "[15, 16.5, 18, 19.5] mm"}}
replicates: 2
measure: [{measure}]
""")
        return "".join(line for line in limits(load(path)) if "container.diameter" in line)

    narrow = told()
    assert "the bottom around the outlet of 19.5 mm is 2.25 diameters of a grain wide" in narrow
    (enough,) = re.findall(r"use (\S+) mm or more", narrow)
    assert float(enough) == math.ceil(19.5 + 2 * RING * 3)
    assert told(diameter=enough) == ""
    assert told(kind="conical-silo", more=", angle: 45 deg") == ""
    assert told(measure="packing") == ""


def test_the_outlet_that_a_warning_names_is_wide_enough(tmp_path):
    """Five diameters of 3.01 mm are 15.05 mm: 15 mm would be warned of again."""
    path = study_file(tmp_path, orifices="[12]")
    path.write_text(path.read_text().replace("diameter: 3 mm", "diameter: 3.01 mm"))
    told = labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy").output
    (enough,) = re.findall(r"use (\S+) mm or more", told)
    path.write_text(path.read_text().replace("[12]", f"[{enough}]"))
    assert "clogs" not in labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy").output


def test_the_stiffness_that_a_study_scales_is_what_counts(tmp_path):
    """A study of real glass whose stiffness is scaled down is not told to be softer; else the stated value is named."""
    (stiff,) = (line for line in advice(load_with(tmp_path, "2 MPa", "25 GPa"), 1e4) if "shear_modulus" in line)
    scaled = load_with(tmp_path, "2 MPa", "25 GPa", "stiffness_scale: 1e-4, ")
    assert not any("shear_modulus" in line for line in advice(scaled, 1e4))
    scaled = load_with(tmp_path, "2 MPa", "2500 GPa", "stiffness_scale: 0.01, ")
    (told,) = (line for line in advice(scaled, 1e4) if "shear_modulus" in line)
    assert "1e+07 Pa" in stiff
    assert "1e+09 Pa" in told


@pytest.mark.parametrize("swept", [False, True])
def test_the_modulus_that_a_study_states_is_named(tmp_path, swept):
    """E = 2 G (1 + nu): the same grains, told by the key that the study has."""
    path = tmp_path / "stiff.yaml"
    path.write_text(
        "name: stiff\ngrains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 1000}\n"
        f"contact: {{law: hertz-printed, youngs_modulus: {1 if swept else 60} GPa, poisson_ratio: 0.2, "
        "restitution: 0.5}\n"
        "container: {kind: wedge-hopper, width: 60 mm, height: 300 mm, thickness: 1.01 d, orifice: 24 mm}\n"
        f"{'sweep: {contact.youngs_modulus: [60 GPa]}' if swept else ''}\n"
        "numerics: {dt: 0.1 us}\nfill: {contact: {law: linear, normal_stiffness: 1000 N/m, restitution: 0.5}}\n"
        "measure: [flow_rate]\nreplicates: 2\n"
    )
    study = load(path)
    (told,) = advice(Planner(study, Catalogue(tmp_path / "lab"), labbook_toy.Backend().capabilities).plan(), 1e4)
    assert "contact.youngs_modulus: grains this stiff" in told
    (scene,) = (point.scene for point in study.points)
    height = outline(PointDemand(study, study.points[0])).height
    assert height is not None
    by_g, by_e = softer(scene, height), softer(scene, height, youngs=True)
    assert by_g is not None
    assert by_e is not None
    assert (by_g[0], by_e[0]) == ("contact.shear_modulus", "contact.youngs_modulus")
    assert by_e[1] == pytest.approx(2 * 1.2 * by_g[1])
    assert by_e[2:] == by_g[2:]
    assert f"with {float(f'{by_e[1]:.1g}'):g} Pa grains" in told


SILO = """
name: silo
grains: {{shape: sphere, diameter: {d} mm, density: 2500 kg/m^3, count: {count}}}
contact: {{law: linear, normal_stiffness: 500 N/m, restitution: 0.3, friction: 0.5}}
container: {{kind: cylinder-silo, diameter: {wide} mm, height: 400 mm, orifice: 16 mm}}
sweep: {{container.orifice: "[15, 16, 18, 20] mm"}}
replicates: 3
measure: [flow_rate, packing]
fit: [beverloo_3d]
"""


def warned(tmp_path, **sizes) -> str:
    """Of an empty measure: the warning and its remedy."""
    path = tmp_path / "silo.yaml"
    path.write_text(SILO.format(**sizes))
    plan = Planner(load(path), Catalogue(tmp_path / "lab"), labbook_toy.Backend().capabilities).plan()
    return "".join(said for said in advice(plan) if "packing will probably be empty" in said)


@pytest.mark.parametrize(("wide", "d"), [(24, 3), (24, 3.5), (30, 3.5), (36, 4)])
def test_a_packing_fraction_that_will_be_empty_is_foreseen(tmp_path, wide, d):
    """The bulk keeps 3 d from walls, bottom and surface, and is at least 4 d wide and high: 10 d, and a bed as high."""
    said = warned(tmp_path, wide=wide, d=d, count=3000)
    assert "the bulk, 3 d from walls, bottom and surface, will be smaller than 4 d" in said
    assert "there is no C (bulk density) of beverloo_3d" in said
    assert f"use a container.diameter of {10 * d:g} mm or more" in said
    assert "or take packing out of measure" in said
    assert not warned(tmp_path, wide=10 * d, d=d, count=3000), "what the remedy says is enough"


def test_a_bed_that_will_be_too_low_for_a_packing_fraction_is_foreseen(tmp_path):
    said = warned(tmp_path, wide=36, d=3, count=800)
    (count,) = re.findall(r"use (\d+) grains or more", said)
    assert not warned(tmp_path, wide=36, d=3, count=int(count)), "what the remedy says is enough"
    # a level bed of 33 mm at a packing fraction of 0.55: pi/4 36^2 33 0.55 / (pi/6 3^3)
    assert int(count) == pytest.approx(math.pi / 4 * 36**2 * 33 * 0.55 / (math.pi / 6 * 27), rel=0.1)


def test_what_is_foreseen_of_a_packing_is_what_is_measured(tmp_path):
    """One rule: a bed of which all columns are as high as foreseen has the bulk that is foreseen."""
    for count in (800, 1500):
        scene = Scene(
            grains=Spheres(diameter=3e-3, density=2500, count=count),
            contact=LinearSpringDashpot(normal_stiffness=1e3),
            container=CylinderSilo(diameter=0.036, height=0.4, orifice=0.016),
        )
        surface = (expected_bed_height(scene) or 0.0) / 1.1
        side = np.arange(-0.018, 0.018, 1e-3)
        x, y = (axis.ravel() for axis in np.meshgrid(side, side))
        tops = np.column_stack([x, y, np.full(len(x), surface - 1.5e-3)])[np.hypot(x, y) < 0.0165]
        still = np.zeros((len(tops), 3))
        assert bulk(scene, Packing(x=tops, v=still, omega=still)) == bulk_below(scene, surface)
        empty = MEASURES["packing"].foreseen_empty(scene) is not None
        assert empty == bulk_below(scene, surface).smaller_than(4 * 3e-3)
        assert empty == (count == 800)


def test_runs_that_nothing_ends_are_told_of(tmp_path):
    path = tmp_path / "box.yaml"
    path.write_text(
        "name: box\ngrains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 3000}\n"
        "contact: {law: linear, normal_stiffness: 1000 N/m, friction: 0.4, restitution: 0.5}\n"
        "container: {kind: box, width: 40 mm, depth: 40 mm, height: 200 mm}\nmeasure: [packing]\nreplicates: 2\n"
    )
    plain, lab = path.read_text(), Catalogue(tmp_path / "lab")
    (told,) = advice(Planner(load(path), lab, labbook_toy.Backend().capabilities).plan())
    assert "stop.max_time: this container has no outlet, so every run lasts 59.5 s" in told
    path.write_text(f"{plain}stop: {{max_time: 10 ms}}\n")
    assert not list(advice(Planner(load(path), lab, labbook_toy.Backend().capabilities).plan()))


def test_short_plans_are_not_told_to_be_softer(tmp_path):
    made, *_ = planned(tmp_path, count=1000)
    stiff = load_with(tmp_path, "2 MPa", "25 GPa")
    assert any("shear_modulus" in line for line in advice(stiff, 1e4))
    assert not any("shear_modulus" in line for line in advice(stiff, 1))
    assert not list(advice(made, 1e4))


def load_with(tmp_path, old, new, numerics=""):
    path = tmp_path / "changed.yaml"
    path.write_text(
        STUDY.format(count=1000, orifices="[18, 24]", replicates=2)
        .replace(old, new)
        .replace("numerics: {dt: 10 us", f"numerics: {{{numerics}dt: 0.1 us")
    )
    return Planner(load(path), Catalogue(tmp_path / "lab"), labbook_toy.Backend().capabilities).plan()


def test_grains_that_memory_cannot_hold_are_refused(tmp_path):
    made, *_ = planned(tmp_path, count=100_000_000)
    told = too_large(made, 2, 24e9)
    assert told is not None
    assert "2 runs at once of 100000000 grains take about 160 GB" in told
    assert "use at most 10000000 grains" in told
    assert too_large(made, 1, 1e12) is None
    done = labbook(
        "plan", study_file(tmp_path, count=100_000_000), "--lab", tmp_path / "lab", "--backend", "toy", check=False
    )
    assert done.exit_code == 1
    assert "grains.count" in done.output


def test_a_device_that_is_not_there_is_said_by_plan(tmp_path):
    made, _, _ = planned(tmp_path)
    cpu, gpu = Device("cpu", "a processor"), Device("cuda:0", "a card")
    backend = backend_of("toy", survey=lambda self: Survey({}, (cpu,)))
    plain = "use --device cpu or leave --device out"
    points = [point.shared for point in made.points]
    with pytest.raises(Unsupported, match=f"toy has no cuda:0 here; it has cpu; {plain}, or use another backend"):
        check(backend, "cuda:0", points)
    backend.capabilities = type(backend.capabilities)(**{**vars(backend.capabilities), "devices": ("cpu", "cuda:0")})
    check(backend, "cpu", points)
    with pytest.raises(
        Unsupported, match=f"it has cpu; use --backend numba, .*, or {plain}, or install the driver for cuda"
    ):
        check(backend, "cuda:0", points)
    both = backend_of("toy", survey=lambda self: Survey({}, (cpu, gpu)))
    both.capabilities, backend = backend.capabilities, both
    check(backend, "cuda:0", points)
    with pytest.raises(Unsupported, match=f"no cuda:1 here; it has cpu, cuda:0; use --device cuda:0, or {plain}$"):
        check(backend, "cuda:1", points)


def test_an_backend_that_cannot_be_imported_is_told_by_plan(tmp_path, monkeypatch):
    def missing(*_):
        raise ModuleNotFoundError("No module named 'warp'")

    monkeypatch.setattr(labbook_toy.Backend, "specialise", missing)
    done = labbook("plan", study_file(tmp_path), "--lab", tmp_path / "lab", "--backend", "toy", check=False)
    assert done.exit_code == 1
    assert "No module named 'warp'" in done.output
    assert "pip install 'labbook[toy]'" in done.output


def test_a_plan_shows_steps_outlet_and_bed(tmp_path):
    shown = labbook("plan", study_file(tmp_path, count=1000), "--lab", tmp_path / "lab", "--backend", "toy").output
    assert "10 µs" in shown
    assert "D/d" in shown
    assert "141 mm" in shown  # 1000 pi/6 d^3 / (0.55 60 mm 3.03 mm)
    rods = Spherocylinders(diameter=3e-3, length=6e-3, density=1, count=1000)
    assert rods.half_length == 1.5e-3
