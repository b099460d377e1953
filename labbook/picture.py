"""A small picture of a bed of grains: coloured layers of the settled bed, and how they were deformed since.

Grains have the colour of the horizontal layer in which they stood when the bed was at rest, as in experiments with
coloured layers. Grains of several kinds have a colour for each kind, alternately dark and light from layer to layer.
The view is orthographic, from the front (along y). Round silos and deep beds are cut in the plane y = 0: what stands
before it is left out. The background is transparent.

Every pixel belongs to the grain whose surface is nearest there (a z-buffer); it is shaded after all grains are known.
"""

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from labbook.scene.bodies import Bodies
from labbook.scene.geometry import Segment
from labbook.scene.grains import Clumps, Spherocylinders
from labbook.scene.hulls import sphere_centres
from labbook.scene.orientation import axes
from labbook.scene.packing import Packing
from labbook.scene.scene import Scene

SIZE = 240
"""Most pixels of a picture's width and height."""
LAYERS = ("#2f6699", "#e0a13a", "#5b9fd0", "#f3d59a")
"""Colours of layers from the bottom up, over and over."""
KIND_COLOURS = np.array([(230, 159, 0), (0, 114, 178), (0, 158, 115), (204, 121, 167), (213, 94, 0), (86, 180, 233)])
"""Okabe and Ito's colours of kinds of grains, which people of all kinds of sight can tell apart."""
WALL = (125, 132, 145)
"""Grey of walls, which is seen on white and on dark pages."""

_MOST_LAYERS, _THINNEST = 8, 2.0  # diameters: a thinner layer is not seen as one
_DEEP = 6.0  # diameters (of rods, lengths): a bed of this depth and more is cut
_FINE, _COARSE = 3, 2  # pixels that a pixel is the mean of, along x and z
_FINE_LIMIT = 1_200_000  # fine pixels in boxes around grains, from where on coarser ones must do
_BELOW = 0.14  # of the height above the outlet: what is shown of what falls below it
_ABOVE = 1.5  # diameters: what is shown above the settled bed
_CHUNK = 250_000  # samples at a time
_STEP = 1.25  # ratio of sizes of boxes around grains that are drawn together
_LINE = 1.8  # pixels: width of walls
_DARKER, _PALER = 0.9, 0.5  # of the colours of kinds: how dark layers by turns are, and how near to white
_LIGHT = (-0.62, 0.785)  # along y and z: in the plane x = 0, so that mirror images look alike
_AMBIENT, _DIFFUSE, _GLOSS, _SHARP = 0.52, 0.55, 0.25, 20
_RIM = 0.45  # darkening of outlines
_DARK, _FADING = 0.45, 3.0  # darkening far behind the front, and the depth [diameters] at which 63 % of it is reached
_NEARLY = 12  # levels of alpha that make no difference
_DEPTHS = 2**31 - 1  # levels of the z-buffer
_ROW = 2**32 - 1
_NOTHING = 2**63 - 1
_FAR = 1e6  # m: a place that no grain reaches


def bed(scene: Scene, start: Packing, now: Packing, size: int = SIZE) -> bytes:
    """The bed `now` as a PNG of at most `size` x `size` pixels, with an indexed palette and a transparent background.

    start: the settled bed, whose layers give grains their colours; grains of `now` are found in it by their ids. Raises
    ValueError if they are not there, or if the settled bed has no grains.
    """
    from PIL import Image

    stored = io.BytesIO()
    image = Image.fromarray(render(scene, start, now, size)).quantize(256, Image.Quantize.FASTOCTREE)
    colours = np.array(image.getpalette("RGBA"), np.uint8).reshape(-1, 4)
    # a colour is the mean of some, of which few are those of edges: what is solid stays solid
    colours[colours[:, 3] >= 255 - _NEARLY, 3] = 255
    colours[colours[:, 3] <= _NEARLY] = 0
    image.putpalette(colours.tobytes(), "RGBA")
    image.save(stored, "PNG", optimize=True)
    return stored.getvalue()


def render(
    scene: Scene,
    start: Packing,
    now: Packing,
    size: int = SIZE,
    *,
    view: "Raster | None" = None,
    colour: np.ndarray | None = None,
    walls: Sequence[Segment] | None = None,
    strokes: "Strokes | None" = None,
    finest: int = _FINE,
) -> np.ndarray:
    """Pixels of the bed `now` before their colours are reduced.

    Args:
        scene: What is simulated.
        start: The settled bed, as of `bed`.
        now: The bed, as of `bed`.
        size: Most pixels of the width and the height, if there is no `view`.
        view: Part of the plane that is seen; None: as `Raster.of` chooses it.
        colour: Colours of the grains of `now` from 0 to 1, shape [n, 3]; None: those of their layers and kinds.
        walls: Lines (x, z) [m] of the walls; None: those of the section of the container as it opens.
        strokes: Lines over grains and walls; None: none.
        finest: Most points along x and along z that a pixel is the mean of.

    Returns:
        RGBA bytes, shape [height, width, 4]. Raises ValueError as `bed` does.
    """
    view = Raster.of(scene, start, now, size) if view is None else view
    grains = _visible_grains(scene, start, now, view, colour)
    fine = finest if grains.area * (view.scale * finest) ** 2 <= _FINE_LIMIT else _COARSE
    picture = view.finer(fine).shaded(grains)
    parts = picture.reshape(view.down, fine, view.across, fine, 4)
    picture = sum(parts[:, i, :, j] for i in range(fine) for j in range(fine)) / np.float32(fine * fine)
    lines = view.lines(scene.container.section() if walls is None else walls)[..., None]
    picture += lines * (np.append(np.array(WALL, np.float32) / 255, np.float32(1)) - picture)
    if strokes is not None:
        view.draw(picture, strokes)
    picture[..., :3] /= np.maximum(picture[..., 3:], 1e-6)
    return np.rint(picture * 255).astype(np.uint8)


def layer_colours(scene: Scene, start: Packing, rows: np.ndarray) -> np.ndarray:
    """Colours from 0 to 1, shape [n, 3], of grains by layers and kinds; rows [n]: of `start`."""
    layer = layers(scene, start)[rows]
    return _of_kinds(Bodies.of(scene.grains, start).kind[rows], layer) if scene.grains.kinds else _of_layers(layer)


def layers(scene: Scene, start: Packing) -> np.ndarray:
    """Layer of each grain of the settled bed `start`, from 0 at the bottom, shape [n]; all are equally thick."""
    z, grains = start.x[:, 2], scene.grains
    low, high = float(z.min()) - grains.radius, float(z.max()) + grains.radius
    thinnest = _THINNEST * grains.equivalent_diameter
    several = min(_MOST_LAYERS, max(1, int((high - low) / thinnest)))
    return np.minimum(((z - low) / (high - low) * several).astype(np.int64), several - 1)


def cut(scene: Scene, start: Packing) -> bool:
    """True if the bed is shown cut in the plane y = 0: in round silos, and if it is deep."""
    grains = scene.grains
    deep = float(np.ptp(start.x[:, 1])) + grains.diameter > _DEEP * grains.diameter * grains.aspect_ratio
    return scene.container.symmetry == "axial" or deep


def front(scene: Scene, start: Packing) -> float:
    """y [m] of the cut, or of the foremost centres of a bed that is not cut."""
    return 0.0 if cut(scene, start) else float(start.x[:, 1].min())


@dataclass(frozen=True, eq=False)
class Strokes:
    """Lines over a picture, later ones over earlier ones: ends (x, z) [m], shape [k, 2, 2], width in pixels [k], and
    colours from 0 to 1 [k, 3]."""

    ends: np.ndarray
    width: np.ndarray
    colour: np.ndarray


@dataclass(frozen=True, eq=False)
class _Grains:
    """Grains to draw, or the spheres of clumps.

    Args:
        x: Centres [m], shape [n, 3].
        radius: Radii [m], shape [n].
        half: Half segments of rods as vectors [m], shape [n, 3]; None for spheres.
        colour: Base colours from 0 to 1, shape [n, 3].
        front: y [m] from which on colours get darker.
        depth: Depth [m] over which they get darker.
    """

    x: np.ndarray
    radius: np.ndarray
    half: np.ndarray | None
    colour: np.ndarray
    front: float
    depth: float

    @property
    def reach(self) -> np.ndarray:
        """Half of the box around each grain [m], shape [n, 3]."""
        long = np.zeros_like(self.x) if self.half is None else np.abs(self.half)
        return long + self.radius[:, None]

    @property
    def area(self) -> float:
        """Area [m^2] of all boxes as seen from the front."""
        reach = self.reach
        return float((4 * reach[:, 0] * reach[:, 2]).sum())


def _visible_grains(scene: Scene, start: Packing, now: Packing, view: "Raster", colour: np.ndarray | None) -> _Grains:
    """The grains that are in the view, and behind the cut if there is one; colour: as for `render`. Raises ValueError
    for ids that are not those of `start`."""
    assert start.ids is not None
    assert now.ids is not None
    if not np.isin(now.ids, start.ids).all():
        raise ValueError("picture: grains are not those of the settled bed")
    grains, is_cut, plane = scene.grains, cut(scene, start), scene.container.outlet_plane
    if now.q is None and not grains.round:
        raise ValueError(f"picture: the {grains.noun}s have no orientations")
    half = None
    if isinstance(grains, Spherocylinders) and now.q is not None and not grains.round:
        half = axes(now.q) * grains.half_length
    reach = grains.reach if isinstance(grains, Clumps) else grains.radius + (0 if half is None else np.abs(half[:, 2]))
    x, z, bottom = now.x[:, 0], now.x[:, 2], view.z - view.down / view.scale / 2
    farthest = view.across / view.scale / 2 + grains.reach
    in_view = (np.abs(x - view.x) < farthest) & (z - reach < 2 * view.z - bottom) & (z + reach > bottom)
    if plane is not None:  # what falls out of the view is left out as a whole: halves of it would look like a floor
        in_view &= (z > plane) | (z - reach > bottom)
    if is_cut:
        in_view &= now.x[:, 1] >= 0
    indices = np.flatnonzero(in_view)
    rows = start.rows(now.ids[indices])
    x, radius = now.x[indices], Bodies.of(grains, start).radius[rows]
    colour = layer_colours(scene, start, rows) if colour is None else colour[indices].astype(np.float32)
    if isinstance(grains, Clumps) and now.q is not None:
        x, spheres = sphere_centres(grains, x, now.q[indices]), len(grains.spheres)
        radius, colour = (
            np.tile([part.radius for part in grains.spheres], len(rows)),
            np.repeat(colour, spheres, axis=0),
        )
    return _Grains(
        x=x.astype(np.float32),
        radius=radius.astype(np.float32),
        half=None if half is None else half[indices].astype(np.float32),
        colour=colour,
        front=front(scene, start),
        depth=_FADING * grains.diameter,
    )


def _of_layers(layer: np.ndarray) -> np.ndarray:
    table = [[int(text[k : k + 2], 16) / 255 for k in (1, 3, 5)] for text in LAYERS]
    return np.array(table, np.float32)[layer % len(table)]


def _of_kinds(kind: np.ndarray, layer: np.ndarray) -> np.ndarray:
    plain = KIND_COLOURS[kind % len(KIND_COLOURS)].astype(np.float32) / 255
    return np.where((layer % 2 == 0)[:, None], plain * _DARKER, plain + (1 - plain) * _PALER)


def _extent(scene: Scene, packing: Packing) -> tuple[np.ndarray, np.ndarray]:
    """Least and most x and z [m] of grains' surfaces."""
    grains, q = scene.grains, packing.q
    reach = grains.radius
    if isinstance(grains, Spherocylinders) and q is not None:
        reach = reach + grains.half_length * np.abs(axes(q))[:, [0, 2]]
    elif isinstance(grains, Clumps):
        reach = grains.reach
    return (packing.x[:, [0, 2]] - reach).min(axis=0), (packing.x[:, [0, 2]] + reach).max(axis=0)


@dataclass(frozen=True, eq=False)
class Raster:
    """A raster of `across` x `down` pixels around the point (x, z) [m], with `scale` pixels to a metre."""

    x: float
    z: float
    scale: float
    across: int
    down: int

    @classmethod
    def of(cls, scene: Scene, start: Packing, now: Packing, size: int = SIZE) -> "Raster":
        """The container as far as the settled bed reaches, and a little of what is below its outlet, in at most `size`
        x `size` pixels. Raises ValueError if the settled bed has no grains."""
        if not len(start):
            raise ValueError("picture: the settled bed has no grains")
        plane, (least, greatest) = scene.container.outlet_plane, _extent(scene, start)
        (left, low), (right, high) = least, greatest
        ends = np.array(list(scene.container.section())).reshape(-1, 2)
        if not len(ends):  # free grains are followed
            ends = np.array([least, greatest, *(_extent(scene, now) if len(now) else ())])
        far, high = right - left, high + _ABOVE * scene.grains.diameter  # what is farther than the bed is wide is cut
        (outer, lowest), (farthest, _) = ends.min(axis=0), ends.max(axis=0)
        left, right = max(left - far, min(left, outer)), min(right + far, max(right, farthest))
        low = max(low - far, min(low, lowest))
        if plane is not None:
            low = min(low, max(low - far, plane - _BELOW * (high - plane)))
        elif len(now):
            high = min(high + far, max(high, _extent(scene, now)[1][1]))
        scale = (size - 2 * _LINE) / max(right - left, high - low)
        across, down = (math.ceil(length * scale + 2 * _LINE - 1e-6) for length in (right - left, high - low))
        return cls(float(left + right) / 2, float(low + high) / 2, float(scale), across, down)

    def finer(self, fine: int) -> "Raster":
        """The same view with `fine` x `fine` times as many pixels."""
        return Raster(self.x, self.z, self.scale * fine, self.across * fine, self.down * fine)

    def _x(self, column: np.ndarray) -> np.ndarray:
        return ((column + 0.5 - self.across / 2) / self.scale + self.x).astype(np.float32)

    def _z(self, row: np.ndarray) -> np.ndarray:
        return (self.z - (row + 0.5 - self.down / 2) / self.scale).astype(np.float32)

    def shaded(self, grains: _Grains) -> np.ndarray:
        """Colours times coverage, and coverage, shape [down, across, 4], from 0 to 1."""
        picture = np.zeros((self.down * self.across, 4), np.float32)
        if len(grains.x):
            key, start, step = self._nearest(grains)
            hit = np.flatnonzero(key != _NOTHING)
            rows, y = (key[hit] & _ROW), (key[hit] >> 32) * step + start
            x, z = self._x(hit % self.across), self._z(hit // self.across)
            picture[hit, :3] = _shade(grains, rows, np.stack([x, y.astype(np.float32), z]))
            picture[hit, 3] = 1
        return picture.reshape(self.down, self.across, 4)

    def _nearest(self, grains: _Grains) -> tuple[np.ndarray, float, float]:
        """Of each pixel, level of depth times 2^32 plus row of the nearest grain, shape [down * across]; y [m] of the
        level 0, and of one level."""
        reach = grains.reach
        front = grains.x[:, 1] - reach[:, 1]
        order = np.argsort(front, kind="stable")
        start, end = float(front.min()), float((grains.x[:, 1] + reach[:, 1]).max())
        step = (end - start) / (_DEPTHS - 1)
        width, height = (np.ceil(2 * reach[:, k] * self.scale).astype(np.int64) + 1 for k in (0, 2))
        left = np.floor((grains.x[:, 0] - reach[:, 0] - self.x) * self.scale + self.across / 2).astype(np.int64)
        top = np.floor((self.z - grains.x[:, 2] - reach[:, 2]) * self.scale + self.down / 2).astype(np.int64)
        key = np.full(self.down * self.across, _NOTHING, np.int64)
        while len(order):
            several = max(1, int(np.searchsorted(np.cumsum((width * height)[order]), _CHUNK)))
            chunk, order = order[:several], order[several:]
            for rows in _alike(chunk, width, height):
                self._draw(key, grains, rows, left[rows], top[rows], width[rows].max(), height[rows].max(), start, step)
            if len(order):
                level = int((float(front[order[0]]) - start) / step)
                order = self._uncovered(key, level, order, left, top, width, height)
        return key, start, step

    def _uncovered(self, key, level: int, order, left, top, width, height) -> np.ndarray:
        """Select the grains of `order`, all of them behind `level`, that no grain before it hides."""
        gaps = (key >> 32 >= level).reshape(self.down, self.across)
        total = np.zeros((self.down + 1, self.across + 1), np.int32)
        np.cumsum(np.cumsum(gaps, axis=0, dtype=np.int32), axis=1, out=total[1:, 1:])
        x0, x1 = (np.clip(edge[order], 0, self.across) for edge in (left, left + width))
        z0, z1 = (np.clip(edge[order], 0, self.down) for edge in (top, top + height))
        return order[total[z1, x1] - total[z0, x1] - total[z1, x0] + total[z0, x0] > 0]

    def _draw(self, key, grains: _Grains, rows, left, top, width: int, height: int, start: float, step: float) -> None:
        """Draw grains in boxes of one size, at `left` and `top`, into the z-buffer."""
        column, line = left[:, None] + np.arange(width), top[:, None] + np.arange(height)
        centre = grains.x[rows]
        dx, dz = self._x(column) - centre[:, :1], self._z(line) - centre[:, 2:]
        dx[(column < 0) | (column >= self.across)] = _FAR
        dz[(line < 0) | (line >= self.down)] = _FAR
        u, w = dx[:, None, :], dz[:, :, None]
        if grains.half is None:
            y = _sphere(u, w, grains.radius[rows][:, None, None])
        else:
            y = _capsule(u, w, grains.half[rows].T[..., None, None], grains.radius[rows][:, None, None])
        hit = np.flatnonzero(np.isfinite(y))
        pixel = (line[:, :, None] * self.across + column[:, None, :]).ravel()[hit]
        grain = hit // (width * height)
        level = ((y.ravel()[hit] + (centre[:, 1] - start)[grain]) / step).astype(np.int64)
        np.minimum.at(key, pixel, (level << 32) + rows[grain])

    def lines(self, segments: Sequence[Segment]) -> np.ndarray:
        """Part of each pixel that lines (x, z) [m] of walls cover, shape [down, across]."""
        covered = np.zeros((self.down, self.across), np.float32)
        for segment in segments:
            rows, columns, fraction = self._stroke(segment, _LINE)
            box = covered[rows, columns]
            np.maximum(box, fraction, out=box)
        return covered

    def draw(self, picture: np.ndarray, strokes: Strokes) -> None:
        """Draw lines into a picture, shape [down, across, 4], of colours times coverage."""
        for ends, width, colour in zip(strokes.ends, strokes.width.tolist(), strokes.colour, strict=True):
            rows, columns, fraction = self._stroke(ends.tolist(), width)
            box = picture[rows, columns]
            box += fraction[..., None] * (np.append(colour, 1).astype(np.float32) - box)

    def _stroke(self, segment: Segment, width: float) -> tuple[slice, slice, np.ndarray]:
        """Rows and columns around a line (x, z) [m] of a width in pixels, and how much of each of these pixels it
        covers."""
        across, down, scale = self.across, self.down, self.scale
        (x0, z0), (x1, z1) = (
            ((x - self.x) * scale + across / 2, (self.z - z) * scale + down / 2) for x, z in segment
        )  # fmt: skip
        left, right = (int(np.clip(x, 0, across)) for x in (min(x0, x1) - width, max(x0, x1) + width + 1))
        top, low = (int(np.clip(z, 0, down)) for z in (min(z0, z1) - width, max(z0, z1) + width + 1))
        px, pz = np.arange(left, right) + 0.5 - x0, np.arange(top, low)[:, None] + 0.5 - z0
        ax, az = x1 - x0, z1 - z0
        fraction = np.clip((px * ax + pz * az) / max(ax * ax + az * az, 1e-12), 0, 1)
        away = np.hypot(px - fraction * ax, pz - fraction * az)
        return slice(top, low), slice(left, right), np.clip(width / 2 + 0.5 - away, 0, min(width, 1))


def _alike(rows: np.ndarray, width: np.ndarray, height: np.ndarray) -> Iterator[np.ndarray]:
    """Rows of grains whose boxes are nearly of one size."""
    sort = [np.ceil(np.log(size[rows]) / math.log(_STEP)).astype(np.int64) for size in (width, height)]
    size_class = sort[0] * 1000 + sort[1]
    for number in np.unique(size_class):
        yield rows[size_class == number]


def _sphere(dx: np.ndarray, dz: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """y [m] of the front of a sphere from its centre, at (dx, dz) [m] from it; NaN beside it."""
    with np.errstate(invalid="ignore"):
        return -np.sqrt(radius**2 - dx**2 - dz**2)


def _capsule(dx: np.ndarray, dz: np.ndarray, half: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Front of a cylinder with round ends, as `_sphere`; its axis goes from -half to half [3, ...].

    The line (dx, y, dz) meets the cylinder where y^2 (1 - a_y^2) - 2 y a_y b + dx^2 + dz^2 - b^2 = r^2 with the unit
    vector a of the axis and b = a_x dx + a_z dz; the smaller y is its front.
    """
    length = np.sqrt((half**2).sum(axis=0))
    a = half / length
    b = a[0] * dx + a[2] * dz
    level = np.maximum(1 - a[1] ** 2, 1e-6)
    with np.errstate(invalid="ignore"):
        y = (a[1] * b - np.sqrt((a[1] * b) ** 2 - level * (dx**2 + dz**2 - b**2 - radius**2))) / level
        side = np.where(np.abs(b + a[1] * y) <= length, y, np.nan)
        ends = [_sphere(dx - s * half[0], dz - s * half[2], radius) + s * half[1] for s in (-1, 1)]
    return np.fmin(side, np.fmin(*ends))


def _shade(grains: _Grains, rows: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Colours [n, 3] of the points `at` [3, n] in m on the surfaces of the grains `rows`: lit from the front and above,
    darker towards the outlines and with the depth."""
    normal = at - grains.x[rows].T
    if grains.half is not None:
        half = grains.half[rows].T
        normal -= np.clip((normal * half).sum(axis=0) / (half**2).sum(axis=0), -1, 1) * half
    normal /= grains.radius[rows]
    light = np.maximum(_LIGHT[0] * normal[1] + _LIGHT[1] * normal[2], 0)
    shade = (_AMBIENT + _DIFFUSE * light) * (1 - _RIM * (1 + np.minimum(normal[1], 0)) ** 2)
    behind = np.maximum(at[1] - grains.front, 0)
    shade *= 1 - _DARK * (1 - np.exp(-behind / grains.depth))
    return np.clip(grains.colour[rows] * shade[:, None] + (_GLOSS * light**_SHARP)[:, None], 0, 1)
