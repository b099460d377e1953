"""Picture of a scene: a section through the container in the x-z plane, its outlet, and some grains, to scale."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from html import escape

import numpy as np

from labbook.scene.container import Container
from labbook.scene.geometry import Bounds, Segment
from labbook.scene.grains import Clumps, Grains, Spherocylinders

WIDTH, HEIGHT = 300.0, 300.0
"""Largest size of the container [pixels]."""
GRAIN_LIMIT = 4000
"""Largest number of grains in a picture: the lowest ones of a larger bed."""
_LEAST = 0.75  # pixels: width below which a grain is not seen

_INK, _FAINT = "#3c4250", "#8a8a8a"
_COLOURS = ("#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442")
_MARGIN, _BELOW, _BESIDE = 8.0, 46.0, 74.0

_Grain = tuple[float, float, float, int, float]  # x, z, radius [m], kind and tilt [rad]
_Frame = tuple[float, float, float, float]
_EMPTY = 1000  # rows without a place for a grain after which there is none above
Pixels = Callable[[float, float], tuple[float, float]]
"""Map from x and z [m] to a place in the picture [pixels]."""


def svg(grains: Grains, container: Container, sized: bool = True) -> str:
    """Draw a scene as an SVG element. Grains are placed for the eye, not by physics.

    Args:
        grains: Grains; the lowest GRAIN_LIMIT are drawn.
        container: Container.
        sized: Write the main sizes beside it.

    Returns:
        SVG element; empty if the section shows no wall.
    """
    pile, walls = list[_Grain](), list(container.section())
    listed = container.area is None
    if listed:
        frame = _frame(container)
        pile = [] if frame is None else list(_pile(grains, container, frame))
        top = max([grain[1] for grain in pile], default=-math.inf) + 2 * grains.diameter
        walls = [] if frame is None else [*walls, *_endless(container, (*frame[:3], max(frame[3], top)))]
    if not walls:
        return ""
    ends = np.array(walls).reshape(-1, 2)
    (left, low), (right, high) = ends.min(axis=0), ends.max(axis=0)
    scale = min(WIDTH / max(right - left, 1e-12), HEIGHT / max(high - low, 1e-12))

    def at(x: float, z: float) -> tuple[float, float]:
        return _MARGIN + (x - left) * scale, _MARGIN + (high - z) * scale

    bed = _bed(grains, pile or _rows(grains, container), at, scale)
    lines = "".join(_line(at(*start), at(*end)) for start, end in walls)
    lines += "".join(_line(at(*start), at(*end), _FAINT, 1) for start, end in _opening(container))
    width, height = (right - left) * scale + 2 * _MARGIN, (high - low) * scale
    wide = right - left if listed else None
    sizes = _sizes(grains, container, at, width, height, wide) if sized else ""
    across, down = width + (_BESIDE if sized else 0.0), height + _MARGIN + _BELOW
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{across:.0f}" height="{down:.0f}" '
        f'viewBox="0 0 {across:.0f} {down:.0f}" role="img" '
        f'aria-label="{escape(describe(grains, container))}" font-family="sans-serif" font-size="11">'
        f"{bed}{lines}{sizes}</svg>"
    )


def describe(grains: Grains, container: Container) -> str:
    """Describe a scene in a line: number, shape and size of grains, container and outlet."""
    shape = "spheres" if grains.round else f"{grains.noun}s"
    size = f"d = {_mm(grains.diameter)}"
    if not grains.round:
        size += f", L = {_mm(grains.extent)}"
    orifice = getattr(container, "orifice", None)
    outlet = f", outlet {_mm(orifice)}" if orifice is not None else ""
    return f"{grains.count} {shape} ({size}) in a {container.kind}{outlet}"


def _mm(length: float) -> str:
    return f"{length * 1e3:.4g} mm"


def _opening(container: Container) -> list[Segment]:
    """Lines (x, z) [m] of walls that stand only while the container is filled."""
    return [line for wall in container.close().walls() if wall.opens for line in wall.shape.section()]


def _frame(container: Container) -> _Frame | None:
    """Left, right, low and high end [m] inside of walls listed one by one; None where these are open sideways."""
    (left, _, low), (right, _, high) = container.bounds.low, container.bounds.high
    return (left, right, low, high) if math.isfinite(low) and left < right < math.inf else None


def _endless(container: Container, frame: _Frame) -> Iterator[Segment]:
    """Lines of walls without end, cut where the picture ends."""
    left, right, low, high = frame
    for wall in container.walls():
        if not wall.shape.section():
            yield from wall.shape.section(Bounds((left, -math.inf, low), (right, math.inf, high)))


def _pile(grains: Grains, container: Container, frame: _Frame) -> Iterator[_Grain]:
    """Grains in rows between walls listed one by one, where nothing covers them."""
    left, right, low, _ = frame
    closed, d = container.close().walls(), grains.diameter
    # the upper side of a vessel covers nothing within it
    plates = [line for wall in closed if any(wall.shape.enclosed.endless) for line in wall.shape.section()]
    y_of_plates = {
        wall.name: box.low[1] for wall in closed if (box := wall.shape.bounds).endless == (True, False, True)
    }
    depths = list(y_of_plates.values())
    middle = sum(depths) / len(depths) if depths else 0.0
    deep = max(depths) - min(depths) if depths else None
    volume = grains.count * grains.volume / 0.58
    rng, missing = np.random.default_rng(0), min(GRAIN_LIMIT, grains.count)
    z = (low if container.outlet_plane is None else max(low, container.outlet_plane)) + 0.55 * d
    row = empty = 0
    while missing > 0 and volume > 0 and empty < _EMPTY:
        x = np.arange(left + (0.5 + row % 2 / 2) * grains.extent, right, 1.04 * grains.extent)
        free = np.ones(len(x), bool)
        for end in (-grains.overhang, 0.0, grains.overhang):
            points = np.column_stack([x + end, np.full((len(x), 2), (middle, z))])
            for wall in closed:
                if wall.name not in y_of_plates:
                    free &= wall.shape.inside(points) & (wall.shape.distance(points) >= 0.45 * d)
        for (x0, z0), (x1, z1) in plates:
            if x0 != x1:
                under = z < z0 + (x - x0) * (z1 - z0) / (x1 - x0)
                free &= ~((x >= min(x0, x1)) & (x <= max(x0, x1)) & under)
        for centre in x[free][:missing]:
            yield _grain(grains, rng, float(centre), z)
        missing -= int(free.sum())
        wide = 1.04 * grains.extent * int(free.sum())
        volume -= 0.95 * d * (math.pi / 4 * wide**2 if deep is None else wide * deep)  # without a depth it is round
        row, empty = row + 1, 0 if free.any() else empty + 1
        z += 0.95 * d


def _rows(grains: Grains, container: Container) -> Iterator[_Grain]:
    """Grains of a bed in rows, and a few that fall from each outlet."""
    d = grains.equivalent_diameter if grains.varied else grains.diameter
    long = d if grains.round else grains.extent
    rng, left = np.random.default_rng(0), min(GRAIN_LIMIT, grains.count)
    high = float(getattr(container, "height", math.inf))
    level = _level(grains, container)
    row, z = 0, 0.55 * d
    while left > 0 and z < min(level, high) and (ends := container.span(z)) is not None:
        lean = _lean(container, z)
        start, end = ends[0] + lean * d + long / 2, ends[1] - lean * d - long / 2
        pitch = 1.04 * long
        count = int((end - start) // pitch) + 1 if end > start else 0
        shift = (row % 2) * (end - start - (count - 1) * pitch)  # rows touch the one wall and the other in turn
        for k in range(min(count, left)):
            yield _grain(grains, rng, start + shift + k * pitch, z)
        left -= count
        z += (0.9 if long == d else 1.1) * d
        row += 1
    for outlet in [opening for opening in container.outlets if opening.form]:
        for k in range(3):
            yield _grain(grains, rng, outlet.centre + rng.uniform(-0.3, 0.3) * (outlet.width - d), -(0.9 + 1.5 * k) * d)


def _grain(grains: Grains, rng: np.random.Generator, x: float, z: float) -> _Grain:
    species = grains.species
    kind = int(rng.choice(len(species), p=[entry.share / sum(p.share for p in species) for entry in species]))
    radius = float(species[kind].sizes.draw(rng, 1, grains.diameter)[0]) / 2
    shake = 0.06 * grains.diameter
    tilt = float(rng.normal(0, 0.12)) if grains.elongated else 0.0
    return x + float(rng.uniform(-shake, shake)), z + float(rng.uniform(-shake, shake)), radius, kind, tilt


def _lean(container: Container, z: float) -> float:
    """Room that an inclined wall takes from a grain beside it, in diameters beyond half of one."""
    angle = float(getattr(container, "angle", math.pi / 2))
    inclined = angle < math.pi / 2 - 1e-9 and z < container.rise
    return 0.5 / math.cos(min(angle, 1.2)) - 0.45 if inclined else 0.05


def _level(grains: Grains, container: Container) -> float:
    """Height [m] up to which the bed is drawn: about as high as it will stand."""
    if container.area is None:
        return 0.0
    packed = 0.55 if container.symmetry == "planar" else 0.6
    lost = container.rise / 2  # what a funnel holds less than a straight silo would
    return grains.count * grains.volume / (packed * container.area) + lost


def _bed(grains: Grains, pile: Iterable[_Grain], at: Pixels, scale: float) -> str:
    """SVG paths of the grains, one for each colour and size.

    A path has strokes with round ends, of no length for spheres and those of clumps.
    """
    clump = grains.spheres if isinstance(grains, Clumps) else ()
    half = grains.half_length * scale if isinstance(grains, Spherocylinders) else 0.0
    strokes = defaultdict[tuple[str, str], list[str]](list)
    for x, z, r, kind, tilt in pile:
        px, pz = at(x, z)
        cosine, sine = math.cos(tilt), math.sin(tilt)
        for sphere in clump:  # the long axis lies, the shortest points at the viewer
            along, up = sphere.centre[2] * scale, sphere.centre[1] * scale
            to = f"M{px + along * cosine - up * sine:.1f} {pz - along * sine - up * cosine:.1f}h0"
            strokes[_look(kind, sphere.radius, scale)].append(to)
        if not clump:
            dx, dz = half * cosine, half * sine
            step = f"l{2 * dx:.1f} {-2 * dz:.1f}" if half else "h0"
            strokes[_look(kind, r, scale)].append(f"M{px - dx:.1f} {pz + dz:.1f}{step}")
    return "".join(
        f'<path d="{"".join(moves)}" stroke="{colour}" stroke-width="{width}" stroke-linecap="round" fill="none"/>'
        for (colour, width), moves in strokes.items()
    )


def _look(kind: int, radius: float, scale: float) -> tuple[str, str]:
    """Colour and width of the stroke of a sphere or a rod."""
    return _COLOURS[kind % len(_COLOURS)], f"{max(round(2 * radius * scale * 4) / 4, _LEAST):g}"


def _line(start: tuple[float, float], end: tuple[float, float], colour: str = _INK, width: float = 1.5) -> str:
    return (
        f'<line x1="{start[0]:.1f}" y1="{start[1]:.1f}" x2="{end[0]:.1f}" y2="{end[1]:.1f}" stroke="{colour}" '
        f'stroke-width="{width:g}" stroke-linecap="round"/>'
    )


def _text(x: float, y: float, text: str, anchor: str = "middle") -> str:
    # drawn over a pale edge, so that it reads on dark pages too
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{_INK}" stroke="white" stroke-width="3" '
        f'stroke-opacity="0.75" paint-order="stroke">{escape(text)}</text>'
    )


def _sizes(
    grains: Grains, container: Container, at: Pixels, width: float, height: float, wide: float | None = None
) -> str:
    """SVG texts of the sizes: of the outlet below it, of the container, and of a grain.

    wide: width [m] of a container without a key for it.
    """
    c, elements = container, []
    bottom = _MARGIN + height
    for outlet in [opening for opening in c.outlets if opening.form]:
        (x1, _), (x2, _) = (at(outlet.centre + side * outlet.width / 2, 0) for side in (-1, 1))
        y = bottom + 22
        elements += [_line((x1, y), (x2, y), _FAINT, 1), _line((x1, y - 3), (x1, y + 3), _FAINT, 1)]
        elements += [_line((x2, y - 3), (x2, y + 3), _FAINT, 1)]
        elements.append(_text(min(max((x1 + x2) / 2, 40), width - 10), y + 16, f"D = {_mm(outlet.width)}"))
    across = wide if c.across is None else c.across
    tall = getattr(c, "height", None)
    words = [f"{_mm(across)} wide"] if across is not None else []
    words += [f"{_mm(tall)} high"] if tall is not None else []
    words += [f"d = {_mm(grains.diameter)}", f"{grains.count} grains"]
    elements += [_text(width, _MARGIN + 12 + 15 * k, word, "start") for k, word in enumerate(words)]
    return "".join(elements)
