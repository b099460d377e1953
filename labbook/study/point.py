"""One point of a study: a scene with its filling and numerics."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from labbook import html
from labbook.accuracy import Choice
from labbook.backend.numerics import Numerics
from labbook.scene.scene import Scene
from labbook.study.keys import find, nearest
from labbook.study.schema import Fill


@dataclass(frozen=True, slots=True)
class Point:
    """Point of a study: a scene with its filling and numerics.

    Args:
        index: Index of the point in the study, from 0.
        scene: Scene of the discharge.
        fill: Filling of the closed container.
        numerics: Time step, stiffness and further numerical parameters of the discharge.
        at: Swept values by dotted key, in SI or as words.
        label: Swept values in the units of the study file.
    """

    index: int
    scene: Scene
    fill: Fill
    numerics: Numerics
    at: Mapping[str, float | str]
    label: str
    choice: Choice | None = field(default=None, compare=False)
    """Choice of its numerics for a requested error; None if none was made."""
    unchosen: str = field(default="", compare=False)
    """Reason that numerics could not be chosen for a requested error; empty otherwise."""
    wants_pilot: bool = field(default=False, compare=False)
    """True if a pilot would allow the choice: the study states no time step, and no scene like it was measured."""
    replicates: int | None = field(default=None, compare=False)
    """Replicates that a strategy has proposed for it; None: as many as the study asks for everywhere."""

    def value(self, key: str) -> float | str | None:
        """Value of a key of the scene, `fill` or `numerics`.

        Args:
            key: Dotted key, such as `container.orifice`.

        Returns:
            Its value in SI, or the word; None if this scene does not have the key.

        Raises:
            KeyError: No scene has this key.
        """
        setting = value_of(key, self.scene, self.fill, self.numerics)
        if setting is None and not find(key):
            raise KeyError(f"{key}: no such key; {nearest(key)}")
        return setting

    def __repr__(self) -> str:
        return f"<Point {self.index + 1}: {self.label}>"

    def _repr_html_(self) -> str:
        numerics = f"dt = {self.numerics.dt * 1e6:.4g} µs, stiffness scale {self.numerics.stiffness_scale:g}"
        return html.titled(f"Point {self.index + 1}: {self.label}", self.scene.svg(), html.lines([numerics]))


def value_of(key: str, scene: Scene, fill: Fill, numerics: Numerics) -> float | str | None:
    """SI value (or word) of a dotted key of a scene, its filling or numerics, as `Point.value`."""
    first, *rest = key.split(".")
    setting: Any = {"fill": fill, "numerics": numerics}.get(first) or getattr(scene, first, None)
    for part in rest:
        setting = setting.get(part) if isinstance(setting, Mapping) else getattr(setting, part, None)
    if isinstance(setting, bool):
        return str(setting).lower()
    return float(setting) if isinstance(setting, int | float) else setting if isinstance(setting, str) else None
