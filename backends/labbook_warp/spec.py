"""Features of kernels from a scene. Nothing here needs Warp: plans use it without Warp installed."""

from collections.abc import Sequence
from dataclasses import replace

from labbook_dem import dispatch, features
from labbook_dem.clump_rows import rows_of_grain
from labbook_dem.mesh import MESH_CONTACTS

from labbook.backend import Capabilities, Spec, Unsupported
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.scene import Scene
from labbook_warp.kernels.words import MOST_CONTACTS, MOST_GRAINS


def has_rods(spec: Spec) -> bool:
    """True if rows of grains are rods, with an axis: those of clumps are spheres."""
    return bool(spec.feature("ORIENTED")) and spec.feature("shape") != "clump"


def most_parts(spec: Spec) -> int:
    """Contacts that a grain may have with one wall."""
    return MESH_CONTACTS if spec.feature("MESHES") else plate_parts(spec)


def plate_parts(spec: Spec) -> int:
    """Contacts that a grain may have with one wall that is no mesh."""
    return dispatch.most_parts(spec.feature("walls")) if has_rods(spec) else 1


def specialise(
    capabilities: Capabilities,
    scene: Scene,
    numerics: Numerics,
    probes: Sequence[Probe],
    wide: bool = False,
    parts: int | None = None,
) -> Spec:
    """Features compiled in. LISTED: there are more walls than a grain has entries for.

    Args:
        capabilities: of the backend.
        scene: what is simulated.
        numerics: time step, precision.
        probes: what is recorded.
        wide: compile in the superset of features (`labbook_dem.features.superset`).
        parts: contacts that a grain may have with one wall; None: as many as the kinds of walls compiled in have.

    Raises:
        Unsupported: the backend lacks a feature, or has too few numbers for the grains.
    """
    if scene.grains.count * rows_of_grain(scene) > MOST_GRAINS:
        counted = "spheres of clumps" if rows_of_grain(scene) > 1 else "grains"
        remedy = f"the backend warp numbers at most {MOST_GRAINS} {counted}; use fewer, or the backend numba"
        raise Unsupported("grains.count", remedy)
    spec = features.specialise(capabilities, scene, numerics, probes, wide)
    listed = len(scene.container.walls()) * (parts or most_parts(spec)) > MOST_CONTACTS
    return replace(spec, features=tuple(sorted((*spec.features, ("LISTED", listed)))))
