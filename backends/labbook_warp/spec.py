"""From a scene to what is compiled for it. Nothing here needs Warp: plans ask for it where Warp is not installed."""

from collections.abc import Sequence
from dataclasses import replace

from labbook_dem import dispatch, features
from labbook_dem.mesh import MESH_CONTACTS

from labbook.backend import Capabilities, Spec, Unsupported
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.scene import Scene
from labbook_warp.kernels.words import MOST_CONTACTS, MOST_GRAINS


def most_parts(spec: Spec) -> int:
    """Contacts that a grain may have with one wall."""
    return MESH_CONTACTS if spec.feature("MESHES") else plate_parts(spec)


def plate_parts(spec: Spec) -> int:
    """Contacts that a grain may have with one wall that is no mesh."""
    return dispatch.most_parts(spec.feature("walls")) if spec.feature("ORIENTED") else 1


def specialise(capabilities: Capabilities, scene: Scene, numerics: Numerics, probes: Sequence[Probe]) -> Spec:
    """Features compiled in; LISTED: whether there are more walls than a grain has entries for. Raises Unsupported."""
    if scene.grains.count > MOST_GRAINS:
        remedy = f"the backend warp numbers at most {MOST_GRAINS} grains; use fewer, or the backend numba"
        raise Unsupported("grains.count", remedy)
    found = features.specialise(capabilities, scene, numerics, probes)
    listed = len(scene.container.walls()) * most_parts(found) > MOST_CONTACTS
    return replace(found, features=tuple(sorted((*found.features, ("LISTED", listed)))))
