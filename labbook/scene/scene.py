"""A scene: all that decides how grains move, and nothing else."""

from collections.abc import Iterator

from pydantic import Field, model_validator

from labbook.scene.contact import AnyLaw, ContactLaw, Surface, SurfaceChange
from labbook.scene.container import Box, ConicalSilo, Container, CylinderSilo, Primitives, WedgeHopper
from labbook.scene.drawing import describe, svg
from labbook.scene.grains import Grains, Spherocylinders
from labbook.scene.model import Fault, Model, refuse
from labbook.scene.quantities import Acceleration
from labbook.scene.walls import Wall

STANDARD_GRAVITY = 9.81
_ROOM_FOR_A_GRAIN = {
    WedgeHopper: ("thickness", "orifice", "width"),
    CylinderSilo: ("orifice", "diameter"),
    ConicalSilo: ("orifice", "diameter"),
    Box: ("width", "depth", "height"),
    Primitives: (),
}
"""Sizes of a container that are not less than a grain's diameter."""


class Scene(Model):
    """Grains, the law of their contacts, the container and the surfaces of its walls, and gravity."""

    grains: Grains
    contact: AnyLaw
    container: Container
    walls: dict[str, SurfaceChange] = Field(default_factory=dict)
    """Where surfaces differ from the grains': by wall name, or `all`."""
    gravity: Acceleration = STANDARD_GRAVITY
    """Acceleration of gravity g, along -z."""

    @model_validator(mode="after")
    def _fits_together(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        names = self.wall_names if self.walls else set()
        for name in self.walls:
            if name not in names:
                reason = f"the container has no wall named {name}"
                yield Fault(f"walls.{name}", reason, f"use one of: {', '.join(sorted(names))}")
        yield from self.faults_of_law(self.contact)
        c, d = self.container, self.grains.diameter
        for key in _ROOM_FOR_A_GRAIN[type(c)]:
            size = getattr(c, key)
            if size < d:
                reason = f"the {key} ({size * 1e3:g} mm) is less than the grain diameter"
                yield Fault(f"container.{key}", reason, f"make it {1.01 * d * 1e3:g} mm (1.01 d) or more")

    def faults_of_law(self, contact: ContactLaw) -> Iterator[Fault]:
        """What these grains cannot have of a law, and what is wrong with the pairs of kinds that it states."""
        if contact.rolling_model == "epsd" and isinstance(self.grains, Spherocylinders):
            yield Fault("contact.rolling_model", "rods have no rolling springs", "use cdt, or spheres")
        names, seen = [kind.name for kind in self.grains.kinds], set()
        for pair in contact.between:
            unknown = sorted({name for name in pair.kinds if name not in names})
            if unknown:
                remedy = f"use two of: {', '.join(names)}" if names else "name the kinds in grains.kinds"
                yield Fault("contact.between", f"no kind of grains is called {' or '.join(unknown)}", remedy)
            if frozenset(pair.kinds) in seen:
                reason = f"{' and '.join(pair.kinds)} are listed twice"
                yield Fault("contact.between", reason, "state each pair once")
            seen.add(frozenset(pair.kinds))

    def svg(self) -> str:
        """A picture as SVG: a section through the container with its outlet and some grains, to scale.

        Empty where no wall is seen in it."""
        return svg(self.grains, self.container)

    def __repr__(self) -> str:
        return f"<Scene: {describe(self.grains, self.container)}>"

    def _repr_svg_(self) -> str | None:
        return self.svg() or None

    @property
    def wall_names(self) -> set[str]:
        """Names that `walls` may use: `all`, and every wall of the container, open or closed."""
        parts = (*self.container.walls(), *self.container.close().walls())
        return {"all", *(wall.name for wall in parts)}

    @property
    def surface_of_grains(self) -> Surface:
        """The surface that grains turn to one another."""
        c = self.contact
        return Surface(friction=c.friction, rolling_friction=c.rolling_friction, restitution=c.restitution)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """Surfaces of all contacts that there may be: between kinds, and of each kind at each wall."""
        kinds = range(len(self.grains.species))
        between = [self.surface_between(a, b) for a in kinds for b in kinds]
        return (*between, *(self.surface(wall, kind) for wall in self.container.walls() for kind in kinds))

    def surface_between(self, one: int, other: int) -> Surface:
        """The complete surface that grains of two kinds, by their places in `grains.kinds`, turn to one another."""
        if not self.contact.between:
            return self.surface_of_grains
        names = {self.grains.kinds[one].name, self.grains.kinds[other].name}
        stated = (pair for pair in self.contact.between if set(pair.kinds) == names)
        return self.surface_of_grains.changed(next(stated, SurfaceChange()))

    def surface(self, wall: Wall, kind: int = 0) -> Surface:
        """The complete surface of `wall`: its own, else that of `all`, else what grains of `kind` turn to each other.

        kind: a place in `grains.kinds`; 0 where there are none.
        """
        grains = self.surface_between(kind, kind)
        everywhere, here = (self.walls.get(name, SurfaceChange()) for name in ("all", wall.name))
        return grains.changed(everywhere).changed(here)

    def stiffened(self, factor: float) -> "Scene":
        """The scene with the stiffness of its contacts times `factor`."""
        return self.model_copy(update={"contact": self.contact.stiffened(factor)})

    def close(self, friction: float | None = None, contact: ContactLaw | None = None) -> "Scene":
        """The scene in which its packing is made, by the law `contact` if that is given; `friction` replaces that of
        grains and of walls."""
        container = self.container.close()
        names = {"all", *(wall.name for wall in container.walls())}
        walls = {name: surface for name, surface in self.walls.items() if name in names}
        contact = contact or self.contact
        if friction is not None:
            pairs = tuple(pair.model_copy(update={"friction": None}) for pair in contact.between)
            contact = contact.model_copy(update={"friction": friction, "between": pairs})
            walls = {name: s.model_copy(update={"friction": None}) for name, s in walls.items()}
            walls = {name: s for name, s in walls.items() if s != SurfaceChange()}
        return self.model_copy(update={"container": container, "contact": contact, "walls": walls})
