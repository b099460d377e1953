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
    """One point of a study: a scene with its filling and numerics.

    `at` has what was swept or listed, dotted key -> SI value (the word itself where a key takes words); `label` says
    the same in the units of the file.
    """

    index: int
    scene: Scene
    fill: Fill
    numerics: Numerics
    at: Mapping[str, float | str]
    label: str
    choice: Choice | None = field(default=None, compare=False)
    """Why its numerics are what they are, where they were chosen for an error."""
    unchosen: str = field(default="", compare=False)
    """Why they could not be chosen for a requested error; empty otherwise."""
    wants_pilot: bool = field(default=False, compare=False)
    """Whether they could be chosen after a pilot: its time step is left out, and no scene like it was measured."""
    replicates: int | None = field(default=None, compare=False)
    """Replicates that a strategy has proposed for it; None: as many as the study asks for everywhere."""

    def value(self, key: str) -> float | str | None:
        """SI value (or word) of the dotted `key` of the scene, `fill` or `numerics`; None where it has none.

        Raises KeyError for a key that no scene has.
        """
        found = value_of(key, self.scene, self.fill, self.numerics)
        if found is None and not find(key):
            raise KeyError(f"{key}: no such key; {nearest(key)}")
        return found

    def __repr__(self) -> str:
        return f"<Point {self.index + 1}: {self.label}>"

    def _repr_html_(self) -> str:
        numerics = f"dt = {self.numerics.dt * 1e6:.4g} µs, stiffness scale {self.numerics.stiffness_scale:g}"
        return html.titled(f"Point {self.index + 1}: {self.label}", self.scene.svg(), html.lines([numerics]))


def value_of(key: str, scene: Scene, fill: Fill, numerics: Numerics) -> float | str | None:
    """As `Point.value`."""
    first, *rest = key.split(".")
    found: Any = {"fill": fill, "numerics": numerics}.get(first) or getattr(scene, first, None)
    for part in rest:
        found = found.get(part) if isinstance(found, Mapping) else getattr(found, part, None)
    if isinstance(found, bool):
        return str(found).lower()
    return float(found) if isinstance(found, int | float) else found if isinstance(found, str) else None
