"""Grains, walls and fields as legacy VTK files (version 3.0, binary), which ParaView opens as they are.

Numbers are big-endian, as the format has them: those of grains and walls in single precision, those of fields in
double.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from labbook.fields import Fields, Layer, Ring
from labbook.lab.folder import write_bytes
from labbook.scene.geometry import Mesh

_TITLE_LENGTH = 255  # of the format
_TYPES = {"int": ">i4", "float": ">f4", "double": ">f8"}
_SHORT = 63  # bytes of a text whose length is coded in one byte


def write_grains(
    path: Path,
    title: str,
    x: np.ndarray,
    radius: float | np.ndarray,
    vectors: Mapping[str, np.ndarray],
    scalars: Mapping[str, np.ndarray] | None = None,
    *,
    axis: np.ndarray | None = None,
    length: float | None = None,
    kinds: Sequence[str] = (),
) -> None:
    """Write grains as points.

    In ParaView, spheres are a Glyph of type Sphere, or Point Gaussian, scaled by radius. Rods are a Glyph of type
    Cylinder, scaled by axis and length.

    Args:
        path: File to write.
        title: First line of the file.
        x: Centres [m], shape [n, 3].
        radius: Radii [m], shape [n], or one of all grains.
        vectors: Further vectors by name, each of shape [n, 3].
        scalars: Further numbers by name, each of shape [n]; whole numbers stay whole.
        axis: Unit vectors along rods, shape [n, 3].
        length: End-to-end length of rods [m].
        kinds: Names of the values of the scalar `kind`, for the field array `kind_names`.

    Raises:
        ValueError: A column has another length.
    """
    n = len(x)
    numbers = {"radius": np.broadcast_to(np.asarray(radius, float), (n,)), **(scalars or {})}
    arrows = dict(vectors)
    if axis is not None:
        arrows["axis"] = axis
        numbers["length"] = np.full(n, length if length is not None else np.nan)
    cells = np.column_stack([np.ones(n, int), np.arange(n)])
    parts = [*_names("kind_names", kinds), f"POINTS {n} float", _block(x, "float"), f"VERTICES {n} {2 * n}"]
    parts += [_block(cells, "int"), f"POINT_DATA {n}", *_attributes(n, numbers, arrows, {}, "float")]
    _write(path, title, "POLYDATA", parts)


def write_walls(path: Path, title: str, meshes: Mapping[str, Mesh]) -> None:
    """Write walls as triangles, with the number of its wall for each of them.

    The scalar is `wall`; the field array `wall_names` has the names.

    Args:
        path: File to write.
        title: First line of the file.
        meshes: Meshes by name of the wall.
    """
    vertices = np.concatenate([np.empty((0, 3)), *(mesh.vertices for mesh in meshes.values())])
    firsts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes.values())])[:-1]
    corners = [mesh.triangles + first for mesh, first in zip(meshes.values(), firsts, strict=True)]
    triangles = np.concatenate([np.empty((0, 3), int), *corners])
    wall = np.repeat(np.arange(len(meshes)), [len(mesh.triangles) for mesh in meshes.values()])
    n = len(triangles)
    cells = np.column_stack([np.full(n, 3), triangles])
    parts = [*_names("wall_names", list(meshes)), f"POINTS {len(vertices)} float", _block(vertices, "float")]
    parts += [f"POLYGONS {n} {4 * n}", _block(cells, "int"), f"CELL_DATA {n}"]
    _write(path, title, "POLYDATA", [*parts, *_attributes(n, {"wall": wall}, {}, {}, "float")])


def write_series(path: Path, files: Sequence[Path], times: Sequence[float] | np.ndarray) -> None:
    """Write a series for ParaView.

    Args:
        path: File to write; its name ends in .vtk.series.
        files: VTK files in the same folder.
        times: Their times [s].
    """
    entries = [{"name": file.name, "time": float(time)} for file, time in zip(files, times, strict=True)]
    text = json.dumps({"file-series-version": "1.0", "files": entries}, indent=1)
    write_bytes(path, (text + "\n").encode("ascii"), durable=False)


def write_fields(path: Path, title: str, fields: Fields) -> None:
    """Write fields as points of a regular grid: of a layer at y = 0, of rings with x for r (and no y).

    They are density, packing fraction, velocity, kinetic pressure and stress, contact stress where there is one, and of
    rods the nematic order and the orientation. Tensors have the axes of the grid: on rings r, t, z. Unknown values are
    NaN.

    Args:
        path: File to write.
        title: First line of the file.
        fields: Fields.
    """
    grid = fields.grid
    origin, spacing, counts = _lattice(grid)
    numbers = {
        "density": fields.density,
        "packing_fraction": fields.packing_fraction,
        "kinetic_pressure": fields.kinetic_pressure,
    }
    tensors = {"kinetic_stress": fields.kinetic_stress}
    if fields.contact_stress is not None:
        tensors["contact_stress"] = fields.contact_stress
    if fields.axes is not None:
        numbers["nematic_order"] = fields.nematic_order
        tensors["orientation"] = fields.orientation

    def flat(array: np.ndarray) -> np.ndarray:
        """Points with x fastest, then y, then z; components last."""
        rows = np.moveaxis(array, -1, -2) if isinstance(grid, Ring) else array  # rings: r before z
        lead = array.ndim - len(grid.shape)
        return np.moveaxis(rows.reshape(*array.shape[:lead], -1), -1, 0)

    n = int(np.prod(counts))
    head = [f"{name} {' '.join(map(str, values))}" for name, values in
            (("DIMENSIONS", counts), ("ORIGIN", origin), ("SPACING", spacing))]  # fmt: skip
    parts = ({name: flat(array) for name, array in group.items()} for group in (numbers, {"velocity": fields.velocity}))
    scalars, vectors = parts
    attributes = _attributes(n, scalars, vectors, {name: flat(array) for name, array in tensors.items()}, "double")
    _write(path, title, "STRUCTURED_POINTS", [*head, f"POINT_DATA {n}", *attributes])


def _lattice(grid) -> tuple[list[float], list[float], list[int]]:
    """Origin, spacing and number of points along x, y, z."""
    points = dict(zip(grid.axes, grid.points, strict=True))
    across = points["r"] if isinstance(grid, Ring) else points["x"]
    along = np.zeros(1) if isinstance(grid, Ring | Layer) else points["y"]
    lines = [across, along, points["z"]]
    spacing = [float(line[1] - line[0]) if len(line) > 1 else 1.0 for line in lines]
    return [float(line[0]) for line in lines], spacing, [len(line) for line in lines]


def _attributes(n: int, scalars: Mapping, vectors: Mapping, tensors: Mapping, real: str) -> list[str | bytes]:
    """Arrays of points or cells. `real`: type of floating-point numbers."""
    parts: list[str | bytes] = []
    for kind, group, size in (("SCALARS", scalars, 1), ("VECTORS", vectors, 3), ("TENSORS", tensors, 9)):
        for name, array in group.items():
            if np.size(array) != n * size:
                raise ValueError(f"{name} has {np.size(array)} numbers and not {size} for each of {n} points")
            dtype = "int" if np.issubdtype(np.asarray(array).dtype, np.integer) else real
            parts.append(f"{kind} {name} {dtype}{' 1' if kind == 'SCALARS' else ''}")
            parts += ["LOOKUP_TABLE default"] if kind == "SCALARS" else []
            parts.append(_block(array, dtype))
    return parts


def _names(array: str, names: Sequence[str]) -> Iterable[str | bytes]:
    """Field array of texts, each after a byte with its length; empty without names."""
    if not names:
        return
    encoded = [name.encode("ascii", errors="replace")[:_SHORT] for name in names]
    yield "FIELD FieldData 1"
    yield f"{array} 1 {len(names)} string"
    yield b"".join(bytes([0xC0 | len(name)]) + name for name in encoded)


def _block(array: np.ndarray, dtype: str) -> bytes:
    return np.ascontiguousarray(array, _TYPES[dtype]).tobytes()


def _write(path: Path, title: str, kind: str, parts: Sequence[str | bytes]) -> None:
    line = " ".join(title.split())[:_TITLE_LENGTH]
    head = ["# vtk DataFile Version 3.0", line, "BINARY", f"DATASET {kind}"]
    rows = [part.encode("ascii", errors="replace") if isinstance(part, str) else part for part in (*head, *parts)]
    write_bytes(path, b"\n".join([*rows, b""]), durable=False)
