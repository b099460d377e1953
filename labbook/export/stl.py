"""Walls of containers as STL files in metres, for codes that take triangles (`fix mesh/surface` of LIGGGHTS)."""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from labbook.lab.folder import write_bytes
from labbook.scene import Container, Scene
from labbook.scene.geometry import Bounds, Mesh, Segment
from labbook.scene.walls import AROUND
from labbook.study import Study

FEWEST, LARGEST = 3, 10_000
"""Corners that a circle may have in a file."""
_LOOSE = 0.5
"""Solid fraction of the bed by which a container without an end is cut."""


def check_facets(facets: int) -> None:
    """Check the number of corners of a circle.

    Args:
        facets: Number of corners.

    Raises:
        ValueError: It is not from FEWEST to LARGEST.
    """
    if not FEWEST <= facets <= LARGEST:
        raise ValueError(f"facets: {facets} is not from {FEWEST} to {LARGEST}; use 96, or 1000 for a fine circle")


def wall_files(container: Container, within: Bounds, facets: int = AROUND) -> dict[str, str]:
    """Text of the STL file of each wall.

    Args:
        container: Open or closed.
        within: Box [m] in which walls without an end are cut, and above whose top all are.
        facets: Corners of circles. They lie on the circle, so that the middle of a side lies inside of it by the
            sagitta r (1 - cos(pi/facets)).

    Returns:
        Texts by the names of walls; that of a round wall states its sagitta in the name of its solid.
    """
    files = dict[str, str]()
    for wall in container.walls():
        name, mesh = wall.name, wall.shape.mesh(within)
        if "axial" in wall.shape.symmetries and (lines := _profile(wall.shape.section(), within.high[2])):
            mesh = Mesh.joined([Mesh.turned(line, facets) for line in lines])
            radius = max(end[0] for line in lines for end in line)
            name = f"{name} ({facets} corners, sagitta {sagitta(radius, facets):.3g} m)"
        if mesh is not None:
            files[wall.name] = stl(mesh, name)
    return files


def sagitta(radius: float, facets: int) -> float:
    """Compute the sagitta r (1 - cos(pi/n)) of a polygon in a circle.

    Args:
        radius: Radius r of the circle through the corners [m].
        facets: Number n of corners.

    Returns:
        Distance of the middle of a side from the circle [m].
    """
    return 2 * radius * math.sin(math.pi / (2 * facets)) ** 2


def _profile(lines: Iterable[Segment], top: float) -> list[Segment]:
    """Lines (r, z) [m] of a section on one side of the axis, below z = `top`."""
    profile = list[Segment]()
    for line in lines:
        lower, upper = sorted(line, key=lambda end: end[1])
        if min(lower[0], upper[0]) < 0 or lower[1] >= top:
            continue
        if upper[1] > top:
            fraction = (top - lower[1]) / (upper[1] - lower[1])
            upper = lower[0] + fraction * (upper[0] - lower[0]), top
        profile.append((lower, upper))
    return profile


def stl(mesh: Mesh, name: str) -> str:
    """Write a mesh as ASCII STL, without triangles that have no area.

    Args:
        mesh: Mesh.
        name: Name of the solid.

    Returns:
        Text of the file.
    """
    lines = [f"solid {name}"]
    for corners in mesh.vertices[mesh.triangles]:
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        area = np.linalg.norm(normal)
        if area == 0:
            continue
        lines += [f"facet normal {_numbers(normal / area)}", "outer loop"]
        lines += [f"vertex {_numbers(corner)}" for corner in corners]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, f"endsolid {name}", ""])


def _numbers(row: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in row)


def write_walls(study: Study, folder: Path, facets: int = AROUND) -> list[Path]:
    """Write the walls of every container of a study.

    Args:
        study: Needs no runs.
        folder: For the files `point-P-NAME.stl` of the open container and `point-P-closed-NAME.stl` of walls that
            differ in the closed one; P is the first point (from 1) with this container.
        facets: Corners of circles.

    Returns:
        Paths of the files.

    Raises:
        ValueError: `facets` is out of range.
    """
    check_facets(facets)
    paths, containers = list[Path](), set[str]()
    for point in study.points:
        scene = point.scene
        if (key := repr(scene.container)) in containers:
            continue
        containers.add(key)
        within = extent_of(scene)
        opened = wall_files(scene.container, within, facets)
        closed = wall_files(scene.container.close(), within, facets)
        files = opened | {f"closed-{name}": text for name, text in closed.items() if opened.get(name) != text}
        for name, text in files.items():
            folder.mkdir(parents=True, exist_ok=True)
            paths.append(folder / f"point-{point.index + 1}-{name}.stl")
            write_bytes(paths[-1], text.encode(), durable=False)
    return paths


def extent_of(scene: Scene) -> Bounds:
    """Find the box in which walls without end are cut.

    Args:
        scene: Scene.

    Returns:
        Box of the container [m]; where it has no end, twice as far from the origin as the side of a cube with the bed.
    """
    far = 2 * (scene.grains.count * scene.grains.volume / _LOOSE) ** (1 / 3)
    box = scene.container.bounds
    low = [end if math.isfinite(end) else -far for end in box.low]
    high = [end if math.isfinite(end) else far for end in box.high]
    return Bounds((low[0], low[1], low[2]), (high[0], high[1], high[2]))
