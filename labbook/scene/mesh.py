"""Walls of triangles: read from a file of a study, and carried by every scene that has them."""

import base64
import math
from collections.abc import Mapping
from functools import lru_cache
from io import BytesIO
from pathlib import PurePosixPath
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field, StrictBool, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from labbook.scene import attached
from labbook.scene.attached import AttachedError, StudyFolder
from labbook.scene.geometry import Bounds, Mesh, Segment
from labbook.scene.model import Fault, Internal, Model, once, refuse
from labbook.scene.quantities import Angle, Coordinate, Ratio
from labbook.scene.triangles import Flaw, Triangles, turn
from labbook.scene.wall_shape import WallShape

FORMATS = (".stl", ".obj", ".ply")
_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "inch": 0.0254}
_FLAWS = {
    "non-manifold": "edges of more than two triangles",
    "t-junctions": "vertices within the edge of another triangle",
    "intersections": "places where triangles cut one another",
}

_SHARP = math.radians(30)
"""Angle between two triangles above which pictures show the edge between them."""

LengthUnit = Literal["m", "cm", "mm", "um", "inch"]
FlawKind = Literal["non-manifold", "t-junctions", "intersections"]


class MeshFile(Model):
    """A file of triangles, and where they are placed: scaled first, then turned, then moved."""

    file: str
    """File in the format STL, OBJ or PLY, named from the folder of the study, at most 64 MB."""
    unit: LengthUnit
    """Unit of the numbers in the file, which states none."""
    scale: Annotated[Ratio, Field(gt=0)] = 1.0
    """Factor by which it is enlarged."""
    rotate: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Angles of rotations about x, then y, then z."""
    at: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)
    """Place of the file's origin."""
    allow: tuple[FlawKind, ...] = ()
    """Flaws to accept: non-manifold, t-junctions or intersections."""


class _OfFile(str):
    """Numbers that were read from a file, and not stated by a study."""

    __slots__ = ()


def _of_file(value: Any, info: ValidationInfo) -> Any:
    if (info.context or {}).get("units") == "required" and not isinstance(value, _OfFile):
        raise PydanticCustomError("internal", "a study cannot set this")
    return value


_Numbers = Annotated[str, Internal(), BeforeValidator(_of_file)]


class TriangleMesh(WallShape):
    """A surface of triangles from a file. Both sides of it are walls, so it may be a thin sheet."""

    spellings: ClassVar[type[Model] | None] = MeshFile

    kind: Literal["mesh"] = "mesh"
    vertices: _Numbers
    """Places [m] in base64 of doubles, as `Triangles` has them."""
    triangles: _Numbers
    """Their corners in base64 of 32-bit integers."""
    smooth: Annotated[Angle, Field(ge=0, le=math.pi / 3)] = 0.0
    """Largest angle between triangles that stand for one curved surface, on which a grain has one contact; 0 deg: none,
    15 deg is usual for cylinders and cones."""
    encloses: StrictBool = False
    """Grains are within the closed surface, as in a drum; false: around it, or on both sides of a sheet."""

    @model_validator(mode="before")
    @classmethod
    def _by_file(cls, data: Any, info: ValidationInfo) -> Any:
        context = info.context or {}
        if not isinstance(data, Mapping) or not ("file" in data or context.get("units") == "required"):
            return data
        by_file = {key: data[key] for key in MeshFile.model_fields if key in data}
        file = MeshFile.model_validate(by_file, context=context)
        own = {key: value for key, value in data.items() if key not in MeshFile.model_fields}
        numbers = zip(("vertices", "triangles"), _read(file, context.get("beside") or StudyFolder()), strict=True)
        return dict(numbers) | own

    @model_validator(mode="after")
    def _is_surface(self):
        try:
            surface = self.surface
        except ValueError as error:
            refuse([Fault("vertices", f"they are no surface ({error})", "read it from the file again")])
            raise
        if self.encloses and not surface.closed:
            refuse([Fault("encloses", "the surface is not closed", "leave it out, or close the surface")])
        return self

    @classmethod
    def of_surface(cls, surface: Triangles, smooth: float = 0.0, encloses: bool = False) -> "TriangleMesh":
        """Make the wall of a surface.

        Args:
            surface: Surface.
            smooth: Largest angle between triangles of one curved surface [rad].
            encloses: Grains are within the closed surface.

        Returns:
            Wall.

        Raises:
            ValidationError: Grains cannot be within a surface that is not closed.
        """
        vertices, triangles = _encoded(surface)
        return cls(vertices=vertices, triangles=triangles, smooth=smooth, encloses=encloses)

    @property
    def surface(self) -> Triangles:
        """Triangles of the surface."""
        return _decoded(self.vertices, self.triangles)

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Distance [m] of points x, shape [n, 3]: of a closed surface negative on the side without grains."""
        return self.clearance(x, math.inf)

    def clearance(self, x: np.ndarray, reach: float) -> np.ndarray:
        """Distance [m] as `distance` gives it, where its size is at most `reach` [m]; further away any number of its
        sign whose size exceeds `reach`."""
        distances = self.surface.distance(x, reach)
        if not self.surface.closed:
            return distances
        return np.where(self.surface.inside(x) == self.encloses, distances, -distances)

    @property
    def bounds(self) -> Bounds:
        """Box around the vertices."""
        return self.surface.bounds

    @property
    def enclosed(self) -> Bounds:
        """Box around a surface that encloses the grains [m]; without end for others."""
        far = math.inf
        return self.bounds if self.encloses else Bounds((-far, -far, -far), (far, far, far))

    @property
    def effort(self) -> float:
        """Time that `distance` takes, over that of a plane."""
        return 3.0 + len(self.surface.corners) / 100

    @property
    def holds(self) -> bool:
        """True: a sheet, or a solid with a cavity, may be a hopper."""
        return True

    @property
    def ground(self) -> float:
        """Height z [m] of the lowest vertex."""
        return self.bounds.low[2]

    @property
    def prismatic_above(self) -> float:
        """Height z [m] of the highest vertex, above which there is nothing of it."""
        return self.bounds.high[2]

    def carries(self, x: np.ndarray) -> np.ndarray:
        """Points with a triangle straight below them, shape [n]."""
        return self.surface.crossings(x)[1] > 0

    def covers(self, x: np.ndarray) -> np.ndarray:
        """Points with a triangle straight above them, shape [n]."""
        return self.surface.crossings(x)[0] > 0

    def section(self, within: Bounds | None = None) -> tuple[Segment, ...]:
        """Lines (x, z) [m] in which the plane y = 0 cuts the triangles."""
        return self._picture.section()

    def mesh(self, within: Bounds) -> Mesh:
        """All triangles, whatever the box."""
        return self._picture

    @property
    def summary(self) -> str:
        """Number of triangles, closedness, area and extent, in words."""
        surface, size = self.surface, " x ".join(f"{1e3 * side:.3g}" for side in self.bounds.size)
        closed = "closed" if surface.closed else "not closed"
        return f"{len(surface.corners)} triangles, {closed}, area {1e4 * surface.area:.4g} cm^2, {size} mm"

    @property
    def _picture(self) -> Mesh:
        surface = self.surface
        return Mesh(surface.vertices, surface.corners, tuple(surface.vertices[surface.creases(_SHARP)]))

    @property
    def is_transparent(self) -> bool:
        """True: grains are seen through it."""
        return True

    def mirrored(self) -> "TriangleMesh":
        """Mirror image in x = 0."""
        surface = self.surface.moved(lambda places: places * [-1.0, 1.0, 1.0])
        return self.of_surface(surface, self.smooth, self.encloses)

    def __repr__(self) -> str:
        return f"TriangleMesh({len(self.surface.corners)} triangles, {hash(self):x})"


def _encoded(surface: Triangles) -> tuple[_OfFile, _OfFile]:
    arrays = surface.vertices.astype("<f8"), surface.corners.astype("<i4")
    vertices, corners = (_OfFile(base64.b64encode(array.tobytes()).decode("ascii")) for array in arrays)
    return vertices, corners


@lru_cache(maxsize=16)
def _decoded(vertices: str, triangles: str) -> Triangles:
    """Surface of two texts; ValueError for texts without a surface."""
    positions = np.frombuffer(base64.b64decode(vertices, validate=True), "<f8").reshape(-1, 3).astype(np.float64)
    corners = np.frombuffer(base64.b64decode(triangles, validate=True), "<i4").reshape(-1, 3).astype(np.int64)
    if not len(corners) or not np.isfinite(positions).all() or corners.min() < 0 or corners.max() >= len(positions):
        raise ValueError("it has no triangles, or these have no such vertices")
    surface = Triangles(positions, corners)
    if not np.isfinite(surface.normals).all():
        raise ValueError("a triangle has no area")
    return surface


# from files


def _read(source: MeshFile, beside: StudyFolder) -> tuple[_OfFile, _OfFile]:
    form = PurePosixPath(source.file).suffix.lower()
    if form not in FORMATS:
        reason = f"{source.file} is none of {', '.join(FORMATS)}"
        refuse([Fault("file", reason, "save the surface in one of these formats")])
    try:
        return _placed(source, beside.attach(source.file))
    except AttachedError as error:
        refuse([Fault("file", error.reason, error.remedy)])
        raise


@once(8)  # points of a sweep have it in common
def _placed(source: MeshFile, key: str) -> tuple[_OfFile, _OfFile]:
    vertices, corners = _loaded(source.file, attached.content(key))
    if not len(corners) or not np.isfinite(vertices).all():
        refuse([Fault("file", f"{source.file} holds no triangles, or numbers that are not finite", "save it again")])
    scaled = vertices * (_UNITS[source.unit] * source.scale)
    surface, _ = Triangles.welded(scaled @ turn(source.rotate).T + source.at, corners)
    if not len(surface.corners):
        refuse([Fault("file", f"no triangle of {source.file} has an area", "save it again")])
    refuse(_fault(flaw, source.file) for flaw in surface.flaws() if flaw.kind not in source.allow)
    return _encoded(surface)


def _fault(flaw: Flaw, name: str) -> Fault:
    x, y, z = (1e3 * value for value in flaw.at)
    where = f"{name} has {flaw.count} {_FLAWS[flaw.kind]}, one at x, y, z = {x:.4g}, {y:.4g}, {z:.4g} mm"
    return Fault("file", where, f"mend the surface, or state allow: [{flaw.kind}]")


def _loaded(name: str, content: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles as a file of the content states them."""
    try:
        import trimesh
    except ImportError:
        refuse([Fault("file", "reading triangles needs the package trimesh", "pip install 'labbook[mesh]'")])
        raise
    try:
        form = PurePosixPath(name).suffix[1:].lower()
        options: dict[str, Any] = {"process": False, "skip_materials": True}
        scene: Any = trimesh.load(BytesIO(content), file_type=form, force="mesh", **options)
        return np.asarray(scene.vertices, float).reshape(-1, 3), np.asarray(scene.faces, int).reshape(-1, 3)
    except Exception as error:  # whatever a reader of damaged files raises
        refuse([Fault("file", f"{name} cannot be read ({error})", f"save it as {FORMATS[0]} again")])
        raise
