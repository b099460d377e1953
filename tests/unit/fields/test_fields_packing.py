"""The stress of a packing that the CPU backend made balances gravity."""

import numpy as np
import pytest

from labbook.backend import Settled
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Sample
from labbook.fields import Layer, coarse_grain, contacts_of, grains_of
from labbook.filling.placing import place
from labbook.scene import HertzMindlin, Scene, Spheres, WedgeHopper

pytestmark = pytest.mark.compiles

D, OMEGA = 3e-3, 1.5e-3
SAMPLE, CONTACTS = Sample(fields=("x", "v")), Contacts()


@pytest.mark.slow
def test_a_frictionless_bed_carries_its_weight_at_every_height():
    """Without friction side walls carry nothing upwards: the stress over a section holds up what lies above it."""
    labbook_numba = pytest.importorskip("labbook_numba")
    scene = Scene(
        grains=Spheres(diameter=D, density=2500, count=120),
        contact=HertzMindlin(shear_modulus=5e6, poisson_ratio=0.25, friction=0, restitution=0.2),
        container=WedgeHopper(width=0.036, height=0.2, thickness=1.01 * D, orifice=0.02),
    ).close()
    backend, numerics = labbook_numba.Backend(wide=True), Numerics(dt=1e-5)  # kernels are those of the contract's tests
    ensemble = backend.open(backend.specialise(scene, numerics, [SAMPLE, CONTACTS]), 1, "cpu")
    ensemble.admit(scene, numerics, place(scene, "rain", 1), settled_below=1e-10)
    for _ in range(600):
        tables = None
        if any(isinstance(event, Settled) for event in ensemble.advance(1)):
            tables = ensemble.drain()
            break
        ensemble.drain()
    ensemble.close()
    assert tables is not None, "the bed came to rest"
    sample, contacts = tables[SAMPLE], tables[CONTACTS]
    grains = grains_of(sample, scene.grains.mass, scene.grains.mass / 2500, 0, np.inf)
    grid = Layer((-0.03, 0.03), (-0.008, 0.06), 120, 272, depth=1.01 * D)
    found = coarse_grain(grid, OMEGA, grains, contacts_of(contacts, sample, 0, np.inf))
    assert found.contact_stress is not None
    cell = 0.06 / 120 * grid.depth
    z, _ = grid.points
    carried = found.contact_stress[2, 2].sum(axis=1) * cell
    weight = found.density.sum(axis=1) * cell * (z[1] - z[0]) * scene.gravity
    above = weight[::-1].cumsum()[::-1] - weight / 2
    inside = z > 4 * OMEGA  # below, kernels reach to where the floor pushes
    total = 120 * scene.grains.mass * scene.gravity
    assert above[inside][0] > 0.5 * total
    # the cut-off, e^-8, and differences over cells of a sixth of omega
    np.testing.assert_allclose(carried[inside], above[inside], atol=2e-3 * total)
    # central forces exert no torque: the stress is symmetric
    stress = found.contact_stress
    np.testing.assert_allclose(stress, stress.swapaxes(0, 1), atol=1e-9 * abs(stress).max())
