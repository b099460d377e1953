"""A bed from a dense start, on the CPU backend: how soon it rests, and that its opening disturbs nothing."""

import math

import numpy as np
import pytest

pytest.importorskip("numba")

from labbook_numba import Backend

from labbook.filling import place, start_of_discharge
from labbook.lab import LabFolder
from labbook.lab.packings import read_packing
from labbook.plan.demand import demands
from labbook.run.runner import Runner
from labbook.study import define

pytestmark = [pytest.mark.compiles, pytest.mark.slow]
D, G = 3e-3, 9.81


def test_a_dense_start_rests_before_a_rain_has_fallen_and_opens_without_a_jump(tmp_path):
    """The last grain of a rain lands no sooner than it falls freely to the surface of the bed.

    In the first 20 steps after the opening, grains farther than 6 d from the outlet go on as they would if it had
    stayed closed. A bed that lost its springs would release them everywhere, at once.
    """
    asked = define(
        name="dense",
        grains={"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 200},
        contact={"law": "hertz-mindlin", "shear_modulus": "1 MPa", "poisson_ratio": 0.25, "friction": 0.5}
        | {"restitution": 0.2, "rolling_friction": 0.01},
        container={"kind": "wedge-hopper", "width": "40 mm", "height": "120 mm", "thickness": "1.01 d"}
        | {"orifice": "20 mm"},
        fill={"kind": "dense"},
        numerics={"dt": "25 us", "steps_per_beat": 500},
    )
    backend = Backend(wide=True)
    assert Runner(asked, LabFolder(tmp_path), backend).run().tally.ran
    (demand,) = demands(asked, 1)
    scene, closed, numerics = demand.shared.scene, demand.shared.closed, demand.shared.numerics
    record, bed = read_packing(LabFolder(tmp_path).packing(demand.keys(backend.capabilities).packing))
    assert record.kinetic < record.filling.settled_below == 1e-3
    fall = place(closed, "rain", 1).x[:, 2].max() - bed.x[:, 2].max()
    assert record.duration < math.sqrt(2 * fall / G)

    few = numerics.model_copy(update={"steps_per_beat": 20})
    after = []
    for here, start in ((closed, bed), (scene, start_of_discharge(bed, closed, scene))):
        ensemble = backend.open(backend.specialise(here, few), 1, "cpu")
        member = ensemble.admit(here, few, start)
        ensemble.advance(1)
        packing = ensemble.packing(member)
        after.append(packing.v[packing.rows(np.arange(200))])
        ensemble.close()
    x, _, z = bed.x[bed.rows(np.arange(200))].T
    away = np.hypot(np.maximum(np.abs(x) - 10e-3, 0), z)
    change = np.abs(after[1] - after[0]).max(axis=1) / math.sqrt(G * D)
    assert (away > 6 * D).sum() > 50
    assert change[away > 6 * D].max() < 1e-3
    assert change[away < D].max() > 1e-2
