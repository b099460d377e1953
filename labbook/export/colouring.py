"""Colours of grains in films and recordings: layers, speed, species, orientation, contact forces; and their legends."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labbook.export.colour_bar import speed_colours, speed_ticks, two_digits
from labbook.export.frames import Frame, top_speed
from labbook.picture import KIND_COLOURS, layer_colours
from labbook.scene import Bodies, Packing, Scene
from labbook.scene.orientation import axes

COLOURS = ("layers", "speed", "force", "species", "orientation")
"""Properties that grains can be coloured by."""
PALE = (226, 230, 236)
"""Grains behind lines of contact forces."""
_UPRIGHT, _LYING = "#1f5a94", "#e8912d"
_TICKS = (0, 30, 60, 90)  # degrees


class NoColouring(Exception):
    """Grains of a scene do not have the property to colour them by; the message says why and what to do."""


@dataclass(frozen=True, eq=False)
class Legend:
    """Meaning of colours.

    Attributes:
        title: Name of the quantity, with its unit.
        colours: Of the scale from its lower to its upper end, or one for each name, RGB bytes, shape [k, 3].
        ticks: Places on the scale from 0 to 1, with their labels; of names the middles of their fields.
    """

    title: str
    colours: np.ndarray
    ticks: tuple[tuple[float, str], ...]


@dataclass(frozen=True, eq=False)
class Colouring:
    """Colours of the grains of a run.

    Attributes:
        by: Property that they are coloured by, among COLOURS.
        scene: What was simulated.
        start: The packing that the run started from.
        top: Upper end of a scale of speeds [m/s] or forces [N]; not used for others.
    """

    by: str
    scene: Scene
    start: Packing
    top: float = 0.0

    @classmethod
    def of(cls, by: str, scene: Scene, start: Packing, frames: Sequence[Frame], top: float = 0.0) -> "Colouring":
        """Choose colours for frames of a run.

        Args:
            by: Property, among COLOURS.
            scene: Scene of the run.
            start: Packing that the run started from.
            frames: Frames of the run, for the scale of speeds.
            top: Upper end of the scale of forces [N].

        Returns:
            Colouring.

        Raises:
            NoColouring: The grains do not have that property.
        """
        if by not in COLOURS:
            raise NoColouring(f"no colouring is called {by}; use one of {', '.join(COLOURS)}")
        if by == "orientation" and not scene.grains.elongated:
            raise NoColouring("spheres have no orientation; use layers, speed or force")
        if by == "species" and not scene.grains.kinds:
            raise NoColouring("the grains are of one kind only; use layers, speed or force")
        return cls(by, scene, start, top_speed(scene, frames) if by == "speed" else top)

    def of_frame(self, frame: Frame) -> np.ndarray:
        """RGB bytes of the grains of a frame, shape [n, 3]."""
        rows = self.start.rows(frame.ids)
        match self.by:
            case "speed":
                return speed_colours(frame.speed, self.top)[:, :3]
            case "species":
                return KIND_COLOURS[Bodies.of(self.scene.grains, self.start).kind[rows] % len(KIND_COLOURS)]
            case "orientation":
                assert frame.q is not None
                return tilt_colours(np.abs(axes(np.asarray(frame.q, float))[:, 2]))
            case "force":
                return np.tile(np.array(PALE), (len(rows), 1))
        return np.rint(255 * layer_colours(self.scene, self.start, rows)).astype(np.uint8)

    def legend(self) -> Legend | None:
        """Meaning of the colours; None of layers, which have no scale."""
        scale = np.linspace(0, 1, 256)
        match self.by:
            case "speed":
                unit, name = (1.0, "m/s") if self.top >= 0.1 else (1e-3, "mm/s")
                ticks = [(math.sqrt(v / self.top), f"{v / unit:.3g}") for v in speed_ticks(self.top)]
                return Legend(f"speed [{name}]", speed_colours(scale**2, 1.0)[:, :3], _open_end(ticks, self.top / unit))
            case "species":
                names = [kind.name for kind in self.scene.grains.kinds]
                colours = KIND_COLOURS[np.arange(len(names)) % len(KIND_COLOURS)]
                return Legend("", colours, tuple(((k + 0.5) / len(names), name) for k, name in enumerate(names)))
            case "orientation":
                colours = tilt_colours(np.cos(scale * math.pi / 2))
                return Legend("angle to the vertical", colours, tuple((at / 90, f"{at}°") for at in _TICKS))
            case "force":
                weight = weight_of(self.scene, self.start)
                ticks = [(fraction, two_digits(fraction * self.top / weight)) for fraction in (0.0, 0.5, 1.0)]
                title = "normal force / weight of a grain" if self.scene.gravity else "normal force [N]"
                return Legend(title, force_colours(scale), _open_end(ticks, self.top / weight))
        return None


def tilt_colours(upright: np.ndarray) -> np.ndarray:
    """RGB bytes, shape [n, 3], of rods by the cosine of their angle to the vertical, shape [n], from blue (upright) to
    orange (lying)."""
    ends = [np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)], float) for text in (_UPRIGHT, _LYING)]
    fraction = (np.arccos(np.clip(upright, 0, 1)) / (math.pi / 2))[:, None]
    return np.rint(ends[0] * (1 - fraction) + ends[1] * fraction).astype(np.uint8)


def force_colours(fraction: np.ndarray) -> np.ndarray:
    """RGB bytes, shape [n, 3], of forces by their part of the upper end of the scale, from 0 (pale) to 1 (dark)."""
    from matplotlib import colormaps

    return colormaps["inferno_r"](_PALEST + (_DARKEST - _PALEST) * np.clip(fraction, 0, 1), bytes=True)[:, :3]


_PALEST, _DARKEST = 0.12, 0.92  # of the colour map: its ends are white and black


def weight_of(scene: Scene, start: Packing) -> float:
    """Mean weight of a grain [N]; 1 without gravity."""
    return float(Bodies.of(scene.grains, start).mass.mean() * scene.gravity) or 1.0


def _open_end(ticks: Sequence[tuple[float, str]], top: float) -> tuple[tuple[float, str], ...]:
    """Mark the last tick as the end of the scale, which values exceed."""
    return (*ticks[:-1], (1.0, f"≥ {two_digits(top)}"))
