"""The goal `find` with a small silo on the CPU backend: from the study to the outlet, whose promise new beds test."""

import pytest

pytest.importorskip("numba")

from labbook_numba import Backend

from labbook.lab import Catalogue, LabFolder
from labbook.results.find import find
from labbook.results.surface import surface
from labbook.run.runner import Runner
from labbook.study import define

pytestmark = [pytest.mark.compiles, pytest.mark.ring]  # test_campaign_find has the goal on the toy backend


def test_the_outlet_that_gives_a_flow_rate(tmp_path):
    """A layer of 300 spheres; the target is known only by what the silo does: a mean of its range."""
    asked = define(
        name="outlet",
        grains={"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 300},
        contact={"law": "hertz-mindlin", "shear_modulus": "1 MPa", "poisson_ratio": 0.25, "friction": 0.5}
        | {"restitution": 0.2, "rolling_friction": 0.01},
        container={"kind": "wedge-hopper", "width": "50 mm", "height": "140 mm", "thickness": "1.01 d"},
        sweep={"container.orifice": "[18, 30] mm"},
        numerics={"dt": "25 us", "steps_per_beat": 500},
        window={"start": 0.15, "end": 0.6},
        adapt={"find": {"container.orifice": {"flow_rate": "30 g/s", "within": "12 %"}}, "budget": 60},
    )
    summary = Runner(asked, LabFolder(tmp_path), Backend(wide=True)).run()
    assert not summary.tally.failed
    results = find(asked, Catalogue(tmp_path), "numba")
    assert "Promise kept (12 %): 8 held-out beds" in results.campaign[-1], results.campaign
    D = float(results.campaign[-1].removeprefix("find has ended: ").split()[0])
    design = surface(results).inverse("30 g/s")
    assert 1e3 * design.low < D < 1e3 * design.high
    assert 18 < D < 30
    assert len(results.points) >= 4
