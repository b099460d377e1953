"""Lines of a plan on meshes: size, outlets, and the most similar built-in container."""

import math
from collections.abc import Iterable, Iterator

from labbook.filling.bed import PACKED
from labbook.scene import Box, ContainerShape, Scene, TriangleMesh
from labbook.scene.nearest_container import nearest_container, outlets
from labbook.scene.quantities import percent

_LENGTHS = ("width", "diameter", "height", "thickness", "orifice", "gap")


def mesh_lines(scenes: Iterable[Scene]) -> list[str]:
    """Describe the meshes of scenes, each once, and how full closed containers are."""
    scenes = list(scenes)
    smallest = min((min(grain.diameter for grain in scene.grains.smallest()) for scene in scenes), default=0.0)
    meshes = {(part.name, part.shape): None for scene in scenes for part in scene.container.parts
              if isinstance(part.shape, TriangleMesh)}  # fmt: skip
    lines = [line for name, mesh in sorted(meshes, key=lambda named: named[0]) for line in _lines(name, mesh, smallest)]
    return [*lines, *dict.fromkeys(line for scene in scenes for line in _filled(scene))]


def _filled(scene: Scene) -> Iterator[str]:
    """Line on the part of the volume that the grains of a closed container take."""
    container, grains = scene.container, scene.grains
    vessels = {
        part.name: part.shape.surface.volume
        for part in container.parts
        if isinstance(part.shape, TriangleMesh) and part.shape.encloses
    }
    if isinstance(container, Box) and container.lid and not vessels:
        vessels = {"the box": container.volume_below(container.height)}
    for name, volume in vessels.items():
        part = grains.count * grains.volume / volume
        yield (
            f"Grains take {percent(part)} of the {1e3 * volume:.4g} l within {name}; "
            f"a bed of packing fraction {PACKED:g} takes {percent(part / PACKED)}"
        )


def _lines(name: str, mesh: TriangleMesh, smallest: float) -> Iterator[str]:
    """Lines on one mesh; holes through which no grain of the diameter `smallest` [m] fits are no outlets."""
    yield f"Mesh {name}: {mesh.summary}"
    for hole in (hole for hole in outlets(mesh.surface) if hole.diameter >= smallest):
        area, diameter, z = 1e4 * hole.area, 1e3 * hole.diameter, 1e3 * hole.z
        yield f"Mesh {name}: outlet at z = {z:.4g} mm of {area:.4g} cm^2, as a circle of {diameter:.4g} mm"
    near = nearest_container(mesh)
    if near is not None:
        x, y, z = (1e3 * coordinate for coordinate in near.origin)
        turned = ", turned by 90 deg about z" if near.turned else ""
        yield (
            f"Mesh {name}: within {1e3 * near.difference:.3g} mm of container: {_keys(near.container)} with its "
            f"outlet at x, y, z = {x:.4g}, {y:.4g}, {z:.4g} mm{turned}"
        )


def _keys(container: ContainerShape) -> str:
    """Format a container as in a study."""
    sizes = [f"kind: {container.kind}"]
    for key in (*_LENGTHS, "angle"):
        value = getattr(container, key, None)
        if value is not None:
            sizes.append(f"{key}: {math.degrees(value):.4g} deg" if key == "angle" else f"{key}: {1e3 * value:.4g} mm")
    return f"{{{', '.join(sizes)}}}"
