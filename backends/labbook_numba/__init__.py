"""The CPU backend: Numba kernels, one member a core; a large member is split among cores that would be idle."""

from collections.abc import Sequence

from labbook_dem import generated
from labbook_dem.backend import DemBackend
from labbook_dem.features import capabilities

from labbook.backend import Checkpoint, Spec, Unsupported
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.scene import Scene

CACHE_VERSION = 6


class Backend(DemBackend):
    """The CPU backend; see `labbook.backend.Backend`. Numba is not loaded before `open`.

    Args:
        threads: threads that one large scene may use while cores are idle; None: one a core.
        wide: compile in all features that a scene of the same law and shape may need. Tests share kernels by it; no run
            of a study uses it.
    """

    requires = ("numba",)
    capabilities = capabilities(
        "numba",
        CACHE_VERSION,
        frozenset({"double", "mixed"}),
        ("cpu",),
        mixtures=True,
        meshes=True,
        rods_at_meshes=True,
        moving_parts=True,
        periodic=True,
        clumps=True,
    )

    def __init__(self, threads: int | None = None, *, wide: bool = False):
        self._threads, self._wide = threads, wide

    def specialise(self, scene: Scene, numerics: Numerics, probes: Sequence[Probe] = ()) -> Spec:
        """Return the features compiled in. Raises Unsupported."""
        from labbook_dem.features import specialise

        return specialise(self.capabilities, scene, numerics, probes, self._wide)

    def open(self, spec: Spec, slots: int | None = None, device: str = "cpu"):
        """Return an ensemble that steps `slots` members at a time (None: one a core).

        Raises:
            Unsupported: a device other than `cpu`, or Numba is switched off.
        """
        from numba import config

        from labbook.backend.machine import cores

        if getattr(config, "DISABLE_JIT", 0):
            remedy = "unset it, or use --backend reference, which is slow"
            raise Unsupported("NUMBA_DISABLE_JIT", f"the backend numba is switched off by this variable; {remedy}")

        from labbook_numba import compiling
        from labbook_numba.build import kernels
        from labbook_numba.ensemble import Ensemble

        if device != "cpu":
            remedy = "leave --device out, or use --backend warp on a GPU"
            raise Unsupported("device", f"the backend numba runs on cpu, not on {device}; {remedy}")
        compiling.watch()
        module = kernels(spec)
        members = cores()
        return Ensemble(self.capabilities, spec, module, min(slots or members, members), self._threads or members)

    def generated(self, spec: Spec) -> str:
        """See `labbook.backend.Backend`."""
        from labbook_numba.build import module_text

        return module_text(spec)

    def compiled(self, spec: Spec) -> bool:
        """See `labbook.backend.Backend`. Numba is loaded only if anything is cached."""
        if self.missing() or not generated.cache_folder("numba").is_dir():
            return False
        from labbook_numba.build import compiled

        return compiled(spec)

    def compiling(self) -> bool:
        """Return True while Numba compiles a kernel."""
        from labbook_numba import compiling

        return compiling.any_running()

    def verify(self, scene: Scene, numerics: Numerics, checkpoint: Checkpoint, step: int) -> None:
        """See `labbook.backend.Backend`. Nothing is compiled for it."""
        from labbook_dem.ensemble import check_checkpoint

        from labbook_numba.state import STEP
        from labbook_numba.stored import array_names, check_state

        check_checkpoint(self.capabilities, array_names(scene), checkpoint)
        check_state(checkpoint.arrays, scene, numerics)
        if (at := int(checkpoint.arrays["count"][STEP])) != step:
            raise ValueError(f"the checkpoint is of step {at}, not of step {step}")
