"""Scene: everything that decides how grains move, and nothing else."""

import math
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import Annotated, TypeVar

from pydantic import Field, model_validator

from labbook.scene import periodic
from labbook.scene.contact import AnyLaw, ContactLaw, useless
from labbook.scene.container import Container
from labbook.scene.drawing import describe, svg
from labbook.scene.feed import Feed
from labbook.scene.grains import Grains, Spherocylinders
from labbook.scene.material import Material
from labbook.scene.mesh import TriangleMesh
from labbook.scene.model import Fault, Model, refuse
from labbook.scene.quantities import Acceleration
from labbook.scene.restart import Restart
from labbook.scene.surface import Between, Surface, SurfaceChange
from labbook.scene.walls import Wall

STANDARD_GRAVITY = 9.81
_LONGEST_MESH = 1e4
_STIFFNESS = ("youngs_modulus", "shear_modulus", "normal_stiffness")


class Scene(Model):
    """Grains, the law of their contacts, the container and the surfaces of its walls, gravity, and how it is fed."""

    grains: Grains
    contact: AnyLaw
    container: Container
    walls: dict[str, SurfaceChange] = Field(default_factory=dict)
    """Surfaces that differ from the grains': by wall name, or `all`."""
    gravity: Acceleration = STANDARD_GRAVITY
    """Acceleration of gravity g, along -z."""
    # where there is none it is left out of what is stored
    feed: Annotated[Feed | None, Field(exclude_if=lambda feed: feed is None)] = None
    restart: Annotated[Restart | None, Field(exclude_if=lambda restart: restart is None)] = None

    @model_validator(mode="after")
    def _fits_together(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        names = self.wall_names if self.walls else set()
        for name in self.walls:
            if name not in names:
                reason = f"the container has no wall named {name if name.isprintable() else ascii(name)}"
                yield Fault(f"walls.{name}", reason, f"use one of: {', '.join(sorted(names))}")
        yield from self.faults_of_law(self.contact)
        if self.feed is not None and not (self.container.outlets and math.isfinite(self.container.roof)):
            lacks = "side walls that end" if self.container.outlets else "outlet"
            reason = f"a {self.container.kind} has no {lacks}, so there are no grains to feed back"
            yield Fault("feed", reason, "leave feed out, or use a wedge-hopper, cylinder-silo or conical-silo")
        if self.restart is not None and (self.feed is None or self.feed.kind != "reinject"):
            reason = "arches are broken in a bed of constant height only"
            yield Fault("restart", reason, "state feed: {kind: reinject}, or leave restart out")
        elif self.restart is not None and [math.isfinite(outlet.width) for outlet in self.container.outlets] != [True]:
            reason = "grains are pushed above one outlet of a known width, which this container has not"
            yield Fault("restart", reason, "leave restart out, or use a wedge-hopper, cylinder-silo or conical-silo")
        c, d = self.container, self.grains.diameter
        for key in c.at_least_a_grain:
            size = getattr(c, key)
            if size < d:
                reason = f"the {key} ({size * 1e3:g} mm) is less than the grain diameter"
                yield Fault(f"container.{key}", reason, f"make it {1.01 * d * 1e3:g} mm (1.01 d) or more")
        if isinstance(self.grains, Spherocylinders):
            for wall in c.walls():
                if wall.shape.spheres_only:
                    key = "container.lip" if getattr(c, "lip", None) is not None else "container.parts"
                    reason = f"the wall {wall.name} is a {wall.shape.kind}, which has no contacts with rods"
                    yield Fault(key, reason, "use spheres, or leave it out")
                    break
        yield from periodic.faults(c, self.grains)
        for part in c.parts:
            if isinstance(part.shape, TriangleMesh):
                yield from self._faults_of_size(part.name, max(part.shape.bounds.size) / d)

    def _faults_of_size(self, name: str, diameters: float) -> Iterator[Fault]:
        """Faults of a mesh that is some grain diameters long, as in another unit than is meant."""
        if not 1 <= diameters <= _LONGEST_MESH:
            amount = "smaller than a grain" if diameters < 1 else f"more than {_LONGEST_MESH:.0f} of them"
            d = self.grains.diameter
            reason = f"the mesh {name} is {diameters * d * 1e3:.3g} mm long, and a grain {d * 1e3:.3g} mm: {amount}"
            yield Fault("container.parts", reason, "check its unit and scale")

    def faults_of_law(self, law: ContactLaw) -> Iterator[Fault]:
        """Check a law against grains and walls.

        Args:
            law: Contact law, the scene's own or that of the filling.

        Yields:
            Reasons against it.
        """
        if law.rolling_model == "epsd" and self.grains.oriented:
            reason = f"{self.grains.noun}s have no rolling springs"
            yield Fault("contact.rolling_model", reason, "use cdt, or spheres")
        yield from self._faults_between_kinds(law)
        yield from self._faults_of_stiffness(law)
        yield from self._faults_of_ignored(law)

    def _faults_of_ignored(self, law: ContactLaw) -> Iterator[Fault]:
        """Surfaces that state what the law ignores. Walls are stated for the scene's own law."""
        walls = [(f"walls.{name}", wall) for name, wall in self.walls.items()] if law is self.contact else []
        for where, change in (*walls, *(("contact.between", pair) for pair in law.between)):
            for key in law.ignored():
                if getattr(change, key, None) is not None:
                    own = "" if where == "contact.between" else f".{key}"
                    yield Fault(f"{where}{own}", useless(law.law, key), "leave it out")

    def _faults_between_kinds(self, contact: ContactLaw) -> Iterator[Fault]:
        """Faults of the pairs of kinds that a law for these grains states."""
        names, earlier = [kind.name for kind in self.grains.kinds], set()
        for pair in contact.between:
            absent = sorted({name for name in pair.kinds if name not in names})
            if absent:
                remedy = f"use two of: {', '.join(names)}" if names else "name the kinds in grains.kinds"
                yield Fault("contact.between", f"no kind of grains is called {' or '.join(absent)}", remedy)
            if frozenset(pair.kinds) in earlier:
                reason = f"{' and '.join(pair.kinds)} are listed twice"
                yield Fault("contact.between", reason, "state each pair once")
            earlier.add(frozenset(pair.kinds))

    def _faults_of_stiffness(self, law: ContactLaw) -> Iterator[Fault]:
        if law.material is None:
            reason = f"the law {law.law} has no elastic moduli"
            bodies = [(f"walls.{name}", wall) for name, wall in self.walls.items()]
            bodies += [("grains.kinds", kind) for kind in self.grains.kinds]
            for key, body in bodies:
                if body.has_own:
                    yield self._of(law, key, reason, "leave moduli and Poisson's ratio out, or use a law by Hertz")
        springs = [f"walls.{name}.normal_stiffness" for name, w in self.walls.items() if w.normal_stiffness is not None]
        if "normal_stiffness" not in type(law).model_fields:
            reason = f"the law {law.law} has no normal_stiffness"
            remedy = "leave it out, or state a modulus, which laws by Hertz take"
            pairs = ["contact.between" for pair in law.between if pair.normal_stiffness is not None]
            yield from (self._of(law, key, reason, remedy) for key in (*springs, *pairs[:1]))
        elif law.damping == "printed":
            reason = "contact.damping printed uses the grain-grain dashpot at walls, but a wall has another stiffness"
            remedy = "leave it out, or use textbook or clamped"
            yield from (self._of(law, key, reason, remedy) for key in springs)

    def _of(self, law: ContactLaw, key: str, reason: str, remedy: str) -> Fault:
        """Fault at `key`; of another law than the scene's, at that law."""
        if law is self.contact or key.startswith("contact"):
            return Fault(key, reason, remedy)
        return Fault("contact", f"{reason}, which {key} states", "use a law of the same family as in contact")

    def svg(self) -> str:
        """Draw the scene: a section through the container with its outlet and some grains, to scale.

        Returns:
            SVG element; empty if the section shows no wall.
        """
        return svg(self.grains, self.container)

    def __repr__(self) -> str:
        return f"<Scene: {describe(self.grains, self.container)}>"

    def _repr_svg_(self) -> str | None:
        return self.svg() or None

    @property
    def outlet(self) -> float | None:
        """Height z [m] of the plane that grains leave through; None if the container is closed or has no outlet."""
        return None if self.container.closed else self.container.outlet_plane

    @property
    def sink(self) -> float | None:
        """Height z [m] below which grains leave a scene that goes on below its outlet; else None."""
        return None if self.container.closed else self.container.sink

    @property
    def wall_names(self) -> set[str]:
        """Names that `walls` may use: `all`, and every wall of the container, open or closed."""
        parts = (*self.container.walls(), *self.container.close().walls())
        return {"all", *(wall.name for wall in parts)}

    @property
    def surface_of_grains(self) -> Surface:
        """Surface of the contacts between grains, where no pair of kinds states its own."""
        c = self.contact
        return _surface(c.friction, c.rolling_friction, c.restitution)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """Surfaces of all possible contacts: between kinds, and, where walls differ, of each kind at each wall."""
        kinds = range(len(self.grains.species))
        between = [self.surface_between(a, b) for a in kinds for b in kinds]
        if not self.walls:
            return tuple(between)
        return (*between, *(self.surface(wall, kind) for wall in self.container.walls() for kind in kinds))

    def surface_between(self, kind: int, second_kind: int) -> Surface:
        """Find the surface of contacts between grains of two kinds.

        Args:
            kind: Place of one kind in `grains.kinds`; 0 without kinds.
            second_kind: Place of the other.

        Returns:
            Surface, all values stated.
        """
        surface = self.surface_of_grains
        for change in self._between(kind, second_kind):
            surface = surface.changed(change)
        return surface

    def _between(self, kind: int, second_kind: int) -> tuple[Between, ...]:
        """Contact parameters that the law states for two kinds."""
        if not self.contact.between:
            return ()
        names = {self.grains.kinds[kind].name, self.grains.kinds[second_kind].name}
        return tuple(pair for pair in self.contact.between if set(pair.kinds) == names)

    def surface(self, wall: Wall, kind: int = 0) -> Surface:
        """Find the surface of contacts with a wall: its own, else that of `all`, else that of the grains.

        Args:
            wall: Wall of the container.
            kind: Place of the grains' kind in `grains.kinds`; 0 without kinds.

        Returns:
            Surface, all values stated.
        """
        surface = self.surface_between(kind, kind)
        if not self.walls:
            return surface
        everywhere, here = self._wall_changes(wall)
        return surface.changed(everywhere).changed(here)

    def _wall_changes(self, wall: Wall) -> tuple[SurfaceChange, SurfaceChange]:
        """Values that the scene states for all walls, and for this one."""
        everywhere, here = (self.walls.get(name) or _unchanged() for name in ("all", wall.name))
        return everywhere, here

    def law_between(self, kind: int, second_kind: int) -> ContactLaw:
        """Find the law with the stiffness of contacts between two kinds.

        Args:
            kind: Place of one kind in `grains.kinds`; 0 without kinds.
            second_kind: Place of the other.

        Returns:
            Law; `contact` itself where neither kind states a stiffness.
        """
        return self._law(self._material(kind), self._material(second_kind), self._between(kind, second_kind))

    def law(self, wall: Wall, kind: int = 0) -> ContactLaw:
        """Find the law with the stiffness of contacts with a wall.

        A wall is of its own material, else of that of `all`, else of that of `contact`. A stiffness k_n is its own,
        else that of `all`, else that of grains of `kind` with each other.

        Args:
            wall: Wall of the container.
            kind: Place of the grains' kind in `grains.kinds`; 0 without kinds.

        Returns:
            Law; `contact` itself where nothing differs.
        """
        material, changes = self.contact.material, self._wall_changes(wall)
        if material is not None:
            for change in changes:
                material = change.material(material)
        return self._law(self._material(kind), material, (*self._between(kind, kind), *changes))

    @property
    def has_own_stiffness(self) -> bool:
        """True if kinds of grains or walls state a stiffness beside that of `contact`."""
        owners = (*self.grains.kinds, *self.walls.values(), *self.contact.between)
        return any(getattr(owner, name, None) is not None for owner in owners for name in _STIFFNESS)

    def _material(self, kind: int) -> Material | None:
        material = self.contact.material
        return self.grains.kinds[kind].material(material) if material is not None and self.grains.kinds else material

    def _law(
        self, material: Material | None, second_material: Material | None, springs: Iterable[Between | SurfaceChange]
    ) -> ContactLaw:
        """Law for bodies of two materials; without a material, with the last k_n that `springs` state."""
        law = self.contact
        if material is not None and second_material is not None:
            pair_material = material.beside(second_material)
            return law if pair_material == law.material else law.model_copy(update=pair_material._asdict())
        stiffnesses = [spring.normal_stiffness for spring in springs if spring.normal_stiffness is not None]
        return law.model_copy(update={"normal_stiffness": stiffnesses[-1]}) if stiffnesses else law

    def stiffened(self, factor: float) -> "Scene":
        """Scale the stiffness of all contacts.

        Args:
            factor: Factor on the stiffness, above 0.

        Returns:
            Scene with that stiffness, all else as it is.
        """
        if factor == 1.0:
            return self
        pairs = tuple(_stiffer(pair, factor) for pair in self.contact.between)
        contact = self.contact.stiffened(factor).model_copy(update={"between": pairs})
        walls = {name: _stiffer(wall, factor) for name, wall in self.walls.items()}
        grains = self.grains
        if grains.kinds:
            kinds = tuple(_stiffer(kind, factor) for kind in grains.kinds)
            grains = grains.model_copy(update={"kinds": kinds})
        return self.model_copy(update={"grains": grains, "contact": contact, "walls": walls})

    def close(
        self, friction: float | None = None, contact: ContactLaw | None = None, surface_motion: bool = False
    ) -> "Scene":
        """Close the scene for the filling.

        Args:
            friction: Friction coefficient of grains and walls instead of their own.
            contact: Law of the filling; None: that of the scene.
            surface_motion: Surfaces of walls move during the filling too.

        Returns:
            Scene in which the packing is made, without feed and restart.
        """
        container, walls = self.container.close(surface_motion), self.walls
        if walls:
            names = {"all", *(wall.name for wall in container.walls())}
            walls = {name: surface for name, surface in walls.items() if name in names}
        contact = contact or self.contact
        if friction is not None:
            pairs = tuple(pair.model_copy(update={"friction": None}) for pair in contact.between)
            contact = contact.model_copy(update={"friction": friction, "between": pairs})
            walls = {name: s.model_copy(update={"friction": None}) for name, s in walls.items()}
            walls = {name: s for name, s in walls.items() if s != SurfaceChange()}
        return self.model_copy(
            update={"container": container, "contact": contact, "walls": walls, "feed": None, "restart": None}
        )


_M = TypeVar("_M", bound=Model)


def _stiffer(model: _M, factor: float) -> _M:
    """Multiply each stiffness that a model states by `factor`."""
    values = {name: getattr(model, name, None) for name in _STIFFNESS}
    update = {name: factor * value for name, value in values.items() if value is not None}
    return model.model_copy(update=update) if update else model


@lru_cache(maxsize=1)
def _unchanged() -> SurfaceChange:
    """Surface of a wall like the grains."""
    return SurfaceChange()


@lru_cache(maxsize=1024)
def _surface(friction: float, rolling_friction: float, restitution: float) -> Surface:
    return Surface(friction=friction, rolling_friction=rolling_friction, restitution=restitution)
