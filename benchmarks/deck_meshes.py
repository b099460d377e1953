"""OBJ files of studies/decks: a rotor, a gate, and fixed grains on a chute.

python benchmarks/deck_meshes.py studies/decks
"""

import sys
from pathlib import Path

import numpy as np
import trimesh


def sheets(corners: list[np.ndarray]) -> trimesh.Trimesh:
    """Plane sheets by their four corners [mm] in order, each of shape [4, 3]."""
    faces = [[4 * k + i for i in face] for k in range(len(corners)) for face in ((0, 1, 2), (0, 2, 3))]
    return trimesh.Trimesh(np.concatenate(corners), faces, process=False)


def rotor(blades: int = 6, inner: float = 3.0, outer: float = 66.0, half: float = 44.5) -> trimesh.Trimesh:
    """Blades about the y axis. The gap at the axis is narrower than a grain."""
    angles = 2 * np.pi * (np.arange(blades) + 0.5) / blades
    return sheets([
        np.array([[r * np.cos(a), y, r * np.sin(a)] for r, y in
                  ((inner, -half), (outer, -half), (outer, half), (inner, half))])
        for a in angles
    ])  # fmt: skip


def gate(half_x: float = 30.0, half_y: float = 20.0) -> trimesh.Trimesh:
    """A horizontal sheet."""
    return sheets([np.array([[-half_x, -half_y, 0], [half_x, -half_y, 0], [half_x, half_y, 0], [-half_x, half_y, 0]])])


def rough(length: float = 40.0, spacing: float = 1.0, rows: int = 3, radius: float = 0.425) -> trimesh.Trimesh:
    """Fixed spheres on a chute along x, as the upper parts of icosahedra."""
    sphere = trimesh.creation.icosahedron()
    sphere.apply_scale(radius / np.linalg.norm(sphere.vertices[0]))
    upper = sphere.faces[sphere.triangles_center[:, 2] > 0]
    sides = spacing * (np.arange(rows) - (rows - 1) / 2)
    places = [(x, y, 0.0) for x in np.arange(0, length, spacing) for y in sides]
    vertices = np.concatenate([sphere.vertices + np.array(place) for place in places])
    faces = np.concatenate([upper + k * len(sphere.vertices) for k in range(len(places))])
    return trimesh.Trimesh(vertices, faces, process=False)


def obj(mesh: trimesh.Trimesh) -> str:
    """Text of an OBJ file [mm]."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.round(mesh.vertices, 9) + 0.0]
    return "\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in mesh.faces + 1), ""])


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    for make in (rotor, gate, rough):
        (folder / f"{make.__name__}.obj").write_text(obj(make()), encoding="utf-8")
