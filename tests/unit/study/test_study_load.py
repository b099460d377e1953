"""Studies that are right: what a file comes to."""

import math
from pathlib import Path

import pytest

from labbook.study import Study, StudyError, load

BASE = """
name: base
grains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 3000}
contact: {law: hertz-mindlin, shear_modulus: 100 MPa, poisson_ratio: 0.25, friction: 0.5, restitution: 0.2}
container: {kind: wedge-hopper, width: 100 mm, height: 400 mm, thickness: 1.01 d, orifice: 30 mm}
"""


def study(tmp_path: Path, text: str = "", base: str = BASE) -> Study:
    file = tmp_path / "study.yaml"
    file.write_text(base + text)
    return load(file)


def test_the_least_study(tmp_path):
    one = study(tmp_path)
    assert (one.name, one.replicates, one.measure, one.fit) == ("base", 1, ("flow_rate",), ())
    (point,) = one.points
    assert (point.index, point.at, point.label) == (0, {}, "the only point")
    assert point.scene.container.thickness == 0.00303  # pyright: ignore[reportAttributeAccessIssue]
    assert point.scene.container.angle == math.pi / 2  # pyright: ignore[reportAttributeAccessIssue]
    assert not point.scene.container.closed  # pyright: ignore[reportAttributeAccessIssue]
    assert one.record is None
    assert one.reference is None
    assert one.accuracy.flow_rate is None


def test_a_grid_varies_its_last_key_fastest(tmp_path):
    swept = study(tmp_path, 'sweep:\n  container.angle: "[30, 90] deg"\n  container.orifice: [20 mm, 3 cm]\n')
    at = [(p.at["container.angle"], p.at["container.orifice"]) for p in swept.points]
    deg = math.radians
    assert at == [pytest.approx(pair) for pair in ((deg(30), 0.02), (deg(30), 0.03), (deg(90), 0.02), (deg(90), 0.03))]
    assert [p.index for p in swept.points] == [0, 1, 2, 3]
    assert swept.points[1].label == "angle 30 deg, orifice 3 cm"
    assert swept.points[1].scene.container.orifice == 0.03  # pyright: ignore[reportAttributeAccessIssue]


def test_points_zip_and_grid_combine_in_this_order(tmp_path):
    text = """
points:
  - {container.orifice: 18 mm}
  - {container.orifice: 30 mm, container.gap: 0 mm}
sweep:
  contact.friction: [0.3, 0.5]
  zip:
    grains.count: "[1000, 2000]"
    container.width: "[100, 200] mm"
"""
    swept = study(tmp_path, text)
    names = ("container.orifice", "grains.count", "container.width", "contact.friction")
    at = [tuple(p.at[name] for name in names) for p in swept.points]
    expected = [(D, n, w, f) for D in (0.018, 0.03) for n, w in ((1000, 0.1), (2000, 0.2)) for f in (0.3, 0.5)]
    assert at == expected
    assert swept.points[0].value("container.gap") is None
    assert swept.points[4].at["container.gap"] == 0.0
    with pytest.raises(KeyError, match=r"did you mean contact\.friction\?"):
        swept.points[0].value("contact.frictoin")


def test_whatever_is_a_single_value_can_be_swept(tmp_path):
    text = """
sweep:
  walls.all.friction: [0.01, 0.5]
  fill.friction: [0.01, 0.5]
  numerics.dt: [2.5 us, 0.05 rayleigh]
  contact.rolling: [full, rolling]
  gravity: "[1.62, 9.81] m/s^2"
"""
    swept = study(tmp_path, text)
    assert len(swept.points) == 32
    last = swept.points[-1]
    assert last.scene.walls["all"].friction == 0.5
    assert last.fill.friction == 0.5
    assert last.at["contact.rolling"] == "rolling"
    assert last.numerics.dt == last.at["numerics.dt"] == pytest.approx(0.05 * 2.5684793e-5, rel=1e-6)
    assert swept.points[0].numerics.dt == 2.5e-6
    assert swept.points[0].scene.gravity == 1.62


def test_d_is_the_diameter_of_the_point_itself(tmp_path):
    swept = study(tmp_path, 'sweep:\n  grains.diameter: "[2, 4] mm"\n  container.orifice: [8 d]\n')
    sizes = [(p.scene.container.thickness, p.scene.container.orifice) for p in swept.points]  # pyright: ignore[reportAttributeAccessIssue]
    assert sizes == [(0.00202, 0.016), (0.00404, 0.032)]


def test_sections(tmp_path):
    text = """
replicates: 2
accuracy: {flow_rate: 1 %, max_replicates: 5}
fill: {kind: gas, friction: 0.01, settled_below: 1e-5, max_time: 10 s}
window: {start: 20 %, end: 0.5}
stop: {discharged: 70 %, max_time: 1 min, stall: 500 ms}
record: {every: 10 ms, replicates: 2}
numerics: {precision: mixed, skin: 0.2, steps_per_beat: 500, speed_limit: 5 m/s}
measure: [flow_rate, packing]
fit: [janda, beverloo]
walls: {front: {friction: 0.01}}
"""
    one = study(tmp_path, text)
    assert (one.accuracy.flow_rate, one.accuracy.max_replicates) == (0.01, 5)
    assert (one.fill.kind, one.fill.friction, one.fill.settled_below, one.fill.max_time) == ("gas", 0.01, 1e-5, 10.0)
    assert (one.window.start, one.window.end) == (0.2, 0.5)
    assert (one.stop.discharged, one.stop.max_time, one.stop.stall) == (0.7, 60.0, 0.5)
    assert one.record is not None
    assert (one.record.every, one.record.replicates) == (0.01, 2)
    numerics = one.points[0].numerics
    assert (numerics.precision, numerics.skin, numerics.steps_per_beat) == ("mixed", 0.2, 500)
    assert numerics.speed_limit == 5.0
    assert (one.measure, one.fit) == (("flow_rate", "packing"), ("janda", "beverloo"))


def test_reference(tmp_path):
    text = """
sweep: {container.orifice: "[18, 30] mm"}
fit: [power]
reference:
  source: Someone 2020
  power.n: {value: 1.55, error: 0.1}
  power.W_d: {from: 50 g/s, says: W is large}
  rotation.grain_rate.minimum: {at: {container.orifice: 18 mm}, from: 160 mHz, to: 0.32 Hz, says: slow}
  flow_rate:
    - {at: {container.orifice: 6 d}, value: 22 g/s, error: 1 g/s}
    - {at: {container.orifice: 3 cm, contact.law: hertz-mindlin, grains.count: 3000}, value: 57 g/s}
"""
    silo = "container: {kind: cylinder-silo, diameter: 100 mm, height: 400 mm, orifice: 30 mm}\n"
    reference = study(tmp_path, text, BASE.partition("container:")[0] + silo).reference
    assert reference is not None
    assert reference.source == "Someone 2020"
    large, slow = reference.statements
    assert (large.quantity, large.low, large.high, large.says) == ("power.W_d", 0.05, math.inf, "W is large")
    assert (slow.at, slow.low, slow.high) == ({"container.orifice": 0.018}, 0.16, 0.32)
    k, first, second = reference.entries
    assert (k.quantity, k.at, k.value, k.error) == ("power.n", {}, 1.55, 0.1)
    assert (first.quantity, first.at, first.value, first.error) == (
        "flow_rate",
        {"container.orifice": 0.018},
        0.022,
        0.001,
    )
    assert second.at["contact.law"] == "hertz-mindlin"
    assert second.error is None


def test_anchors_share_values(tmp_path):
    text = "walls: {front: &slippery {friction: 0.01}, back: *slippery}\n"
    walls = study(tmp_path, text).points[0].scene.walls
    assert walls["front"] == walls["back"]


@pytest.mark.parametrize(
    ("stated", "number"), [("", 1), ("discharges_per_bed: 3", 3), ("discharges_per_bed: auto", "auto")]
)
def test_discharges_of_each_bed(tmp_path, stated, number):
    one = study(tmp_path, f"accuracy: {{flow_rate: 1 %}}\n{stated}\n")
    assert one.discharges_per_bed == number


def test_a_bed_without_outlet_has_one_run(tmp_path):
    box = BASE.replace("{kind: wedge-hopper, width: 100 mm, height: 400 mm, thickness: 1.01 d, orifice: 30 mm}",
                       "{kind: box, width: 50 mm, depth: 50 mm, height: 300 mm}")  # fmt: skip
    with pytest.raises(StudyError, match=r"discharges_per_bed: the container has no outlet(.|\n)*use replicates"):
        study(tmp_path, "measure: [packing]\ndischarges_per_bed: 2\n", base=box)


def test_a_container_without_outlet(tmp_path):
    base = BASE.partition("container:")[0] + "container: {kind: box, width: 1 cm, depth: 1 cm, height: 1 cm}\n"
    box = study(tmp_path, "measure: [packing]\n", base)
    assert box.points[0].scene.container.outlet_plane is None
