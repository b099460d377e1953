"""The GPU backend: Warp kernels, a whole sweep in one launch."""

from collections.abc import Sequence

from labbook_dem.backend import DemBackend
from labbook_dem.features import capabilities

from labbook.backend import Checkpoint, Expected, Spec, Survey
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.scene import Scene

CACHE_VERSION = 4


class Backend(DemBackend):
    """The GPU backend; see `labbook.backend.Backend`. Planning needs nothing of Warp."""

    requires = ("warp",)
    capabilities = capabilities(
        "warp",
        CACHE_VERSION,
        frozenset({"double", "mixed"}),
        ("cpu", "cuda:0"),
        mixtures=True,
        single_velocities=True,
        meshes=True,
        rods_at_meshes=True,
        moving_parts=True,
        periodic=True,
        clumps=True,
    )

    def __init__(self, lanes: int | None = None, *, wide: bool = False):
        """Make a backend.

        Args:
            lanes: threads a grain on a GPU: 1, 2, 4 or 8; None: the fastest number. Where several share a rod, they are
                at least as many as its parts that may touch a wall: four, or two if all walls are planes.
            wide: compile in all features that a scene of the same law and shape may need. Tests on a processor share
                kernels by it; no run of a study uses it.

        Raises:
            ValueError: another number of threads.
        """
        if lanes not in (None, 1, 2, 4, 8):
            raise ValueError(f"{lanes} threads a grain are not possible: take 1, 2, 4 or 8")
        self._lanes, self._wide = lanes, wide

    def specialise(self, scene: Scene, numerics: Numerics, probes: Sequence[Probe] = ()) -> Spec:
        """Return the features compiled in. Raises Unsupported."""
        from labbook_warp.spec import specialise

        return specialise(self.capabilities, scene, numerics, probes, self._wide)

    def open(self, spec: Spec, slots: int | None = None, device: str = "cpu"):
        """Return an ensemble that grows with its members. Raises Unsupported for a missing device."""
        from labbook_warp.devices import find
        from labbook_warp.ensemble import Ensemble

        return Ensemble(self.capabilities, spec, find(device), slots, self._lanes)

    def generated(self, spec: Spec) -> str:
        """Return the source of the kernels for many equal grains with a thread each."""
        from labbook_warp.build import module_text

        return module_text(spec, uniform=True, lanes=1, registers=0, apart=0, prefetch=0)

    def capacity(self, spec: Spec, scene: Scene, device: str) -> int | None:
        """Number of members of `scene` that fit into the device's free memory.

        None: no limit, or Warp is not installed.
        """
        if self.missing():
            return None
        from labbook_warp.devices import find
        from labbook_warp.room import capacity

        return capacity(spec, scene, find(device))

    def bandwidth(self, device: str) -> float | None:
        """See `labbook.backend.Backend`. None also where Warp is not installed, or too little memory is free."""
        if self.missing():
            return None
        from labbook_warp.copies import present_bandwidth

        return present_bandwidth(device)

    def precompile(self, members: Sequence[Expected], device: str) -> None:
        """See `labbook.backend.Backend`. Only for a GPU is anything compiled."""
        from labbook_warp.compiling import precompile
        from labbook_warp.devices import find

        precompile(members, find(device), self._lanes)

    def compiling(self) -> bool:
        """Return True while kernels that members will need are being compiled."""
        from labbook_warp.compiling import any_running

        return any_running()

    def survey(self) -> Survey:
        """Return versions of Warp and CUDA, and all devices; without Warp, those of the capabilities."""
        if self.missing():
            return super().survey()
        from labbook_warp.devices import survey

        return survey()

    def verify(self, scene: Scene, numerics: Numerics, checkpoint: Checkpoint, step: int) -> None:
        """See `labbook.backend.Backend`. Nothing is compiled for it."""
        from labbook_warp.stored import check

        check(self.capabilities, self.specialise(scene, numerics), scene, numerics, checkpoint)
        if (at := int(checkpoint.arrays["step"])) != step:
            raise ValueError(f"the checkpoint is of step {at}, not of step {step}")
