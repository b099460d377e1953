"""The reference backend: the physics of `labbook_dem` in plain Python, contact by contact.

It has no neighbour lists, blocks, generated code or threads. It shares only the formulas with the other backends, which
are compared with it, and a debugger can step through it (docs/kernels.md). It is about ten thousand times slower than
the CPU backend.
"""

from collections.abc import Sequence

from labbook_dem.backend import DemBackend
from labbook_dem.features import capabilities

from labbook.backend import Checkpoint, Spec, Unsupported
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.scene import Scene

CACHE_VERSION = 1


class Backend(DemBackend):
    """See `labbook.backend.Backend`."""

    capabilities = capabilities(
        "reference",
        CACHE_VERSION,
        frozenset({"double"}),
        ("cpu",),
        mixtures=True,
        meshes=True,
        rods_at_meshes=True,
        moving_parts=True,
        clumps=True,
        periodic=True,
    )

    def specialise(self, scene: Scene, numerics: Numerics, probes: Sequence[Probe] = ()) -> Spec:
        """Return the common features of an ensemble's members; nothing is compiled. Raises Unsupported."""
        from labbook_dem.features import specialise

        return specialise(self.capabilities, scene, numerics, probes)

    def open(self, spec: Spec, slots: int | None = None, device: str = "cpu"):
        """Return an ensemble that steps its members one after the other. Raises Unsupported for a device other than
        `cpu`."""
        from labbook_reference.ensemble import Ensemble

        if device != "cpu":
            raise Unsupported("device", f"the backend reference runs on cpu, not on {device}; leave --device out")
        return Ensemble(self.capabilities, spec)

    def verify(self, scene: Scene, numerics: Numerics, checkpoint: Checkpoint, step: int) -> None:
        """See `labbook.backend.Backend`."""
        from labbook_reference.member import check_checkpoint

        check_checkpoint(self.capabilities, scene, checkpoint)
        if (at := int(checkpoint.arrays["step"])) != step:
            raise ValueError(f"the checkpoint is of step {at}, not of step {step}")
