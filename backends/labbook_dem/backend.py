"""Methods common to all backends with the physics of this package."""

from collections.abc import Mapping

from labbook import backend
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Table, Traction
from labbook.scene import Packing, Scene


class DemBackend(backend.Backend):
    """Base of the backends with this physics; see `labbook.backend.Backend`."""

    def tractions(self, scene: Scene, numerics: Numerics, packing: Packing, probe: Traction) -> Table:
        """See `labbook.backend.Backend`."""
        from labbook_dem.plain_walls import at_rest

        return at_rest(scene, numerics, packing, probe)

    def elastic_forces(
        self, scene: Scene, numerics: Numerics, packing: Packing, time: float = 0.0, *, walls: bool = True
    ) -> Table:  # fmt: skip
        """See `labbook.backend.Backend`."""
        from labbook_dem.elastic import elastic_forces

        return elastic_forces(scene, numerics, packing, time, walls=walls)

    def describe(self, scene: Scene, numerics: Numerics) -> Mapping[str, float]:
        """Requested and realised restitution of two grains (mean over ten phases of the step), and the damping used."""
        from labbook_dem.describe import describe

        return describe(scene, numerics)
