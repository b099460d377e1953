"""The two real backends beside each other, on the processor: they must agree until chaos amplifies rounding."""

import numpy as np
import pytest

from labbook.backend import BackendMissing, Unsupported
from labbook.checks.compare.compare import compare
from labbook.cli.work.sides import parse
from labbook.lab import LabFolder
from labbook.study import load

pytestmark = pytest.mark.compiles

STUDY = """
name: tiny
grains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 150}
contact: {law: hertz-mindlin, shear_modulus: 5 MPa, poisson_ratio: 0.25, friction: 0.5, rolling_friction: 0.01,
          restitution: 0.2}
container: {kind: wedge-hopper, width: 36 mm, height: 200 mm, thickness: 1.01 d, angle: 90 deg, orifice: 18 mm}
replicates: 2
numerics: {steps_per_beat: 200}
window: {start: 0.15, end: 0.6}
measure: [flow_rate, packing, outlet_profiles]
"""


@pytest.mark.ring
def test_numba_and_warp_agree_until_chaos_takes_over(tmp_path):
    pytest.importorskip("warp", reason="Warp is not installed: pip install 'labbook[warp]'")
    try:
        two = parse("numba,warp", "cpu,cpu")
    except BackendMissing as missing:
        pytest.skip(str(missing))
    path = tmp_path / "tiny.yaml"
    path.write_text(STUDY)
    verdict, failed = compare(load(path), LabFolder(tmp_path / "lab"), two, 0.03)
    assert not failed
    (point,) = verdict.points
    found = point.divergence
    assert found is not None
    # After one frame there is nothing but rounding of positions and forces, some 100 steps of it.
    assert 0 < found.largest[1] < 1e-12
    assert found.ended == "diverged"
    # One and the same motion amplifies rounding by e once in a collision, sqrt(d/g)/10 or so: a difference in the
    # physics would show at once, at 1e-6 d and more within sqrt(d/g) = 17 ms.
    early = np.array(found.time) < 0.017
    assert max(np.array(found.largest)[early]) < 1e-9
    assert found.agree_until > 0.03
    assert all(one.finding != "untested" for one in point.contrasts)
    # Two replicates decide little; their means must still be those of one and the same hopper.
    flow, covered, velocity, packing = point.contrasts
    assert (covered.quantity, velocity.quantity) == ("outlet_area_fraction", "outlet_velocity")
    for one in (flow, covered, velocity):
        assert one.paired
        assert one.difference == pytest.approx(0, abs=0.25)
    assert packing.difference == pytest.approx(0, abs=0.1)


def test_a_gpu_that_is_not_there_is_said_before_anything_runs(tmp_path):
    wp = pytest.importorskip("warp", reason="Warp is not installed: pip install 'labbook[warp]'")
    if wp.get_cuda_device_count():
        pytest.skip("a GPU is here")
    try:
        two = parse("numba,warp", "cpu,cuda:0")
    except BackendMissing as missing:
        pytest.skip(str(missing))
    path = tmp_path / "tiny.yaml"
    path.write_text(STUDY)
    with pytest.raises(Unsupported, match=r"no (device )?cuda:0"):
        compare(load(path), LabFolder(tmp_path / "lab"), two, 0.03)
    assert not (tmp_path / "lab").exists()
