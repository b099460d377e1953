"""Identities: hashes of what decides a result, and of nothing else.

A scene counts by its grains, its law, its walls (shape, motion and complete surface) and gravity, not by how
a study spells them: two containers that amount to the same walls are one scene. Stop rules, probes, guards,
threads, slots and devices are no part of any key; they are coverage or provenance.
"""

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from labbook.backend import Capabilities
from labbook.backend.numerics import Numerics
from labbook.scene import ContactLaw, Scene, Surface, Wall
from labbook.scene.material import OwnMaterial
from labbook.scene.model import Model, Text, canonical, digest, once
from labbook.scene.walls import Frustum, Plane, Strip, SurfaceMotion, WallShape

_GUARDS = ("speed_limit", "overlap_limit")


def scene_key(scene: Scene) -> str:
    """Key of what is simulated: grains, law, walls, motion, gravity, feed."""
    return digest(scene_identity(scene))


def scene_identity(scene: Scene) -> dict[str, Any]:
    """What `scene_key` hashes. A law's friction, rolling friction and restitution are kept: they act between
    grains. Parts that many scenes have in common are canonical JSON already."""
    container, kinds = scene.container, range(len(scene.grains.kinds))
    grains: Any = _text(scene.grains)
    contact: dict[str, Any] = {}
    if kinds:  # what acts between them, however it is spelled
        contact["surfaces"] = [[_text(scene.surface_between(a, b)) for b in kinds] for a in kinds]
        stated = [kind.model_dump(mode="json", exclude=set(OwnMaterial.KEYS)) for kind in scene.grains.kinds]
        grains = {**scene.grains.model_dump(mode="json"), "kinds": stated}
    as_grains = None if scene.walls else _surfaces(scene, None)
    walls: list[Any] = [_wall(wall, as_grains or _surfaces(scene, wall), bool(kinds)) for wall in container.walls()]
    if scene.has_own_stiffness:
        sorts = range(len(scene.grains.species))
        pairs = [[_stiffness(scene.law_between(a, b), scene.contact) for b in sorts] for a in sorts]
        contact |= {"stiffness": pairs} if any(map(any, pairs)) else {}
        for place, wall in enumerate(container.walls()):
            if any(own := [_stiffness(scene.law(wall, kind), scene.contact) for kind in sorts]):
                shape, surfaces = wall.shape.model_dump(mode="json"), _surfaces(scene, wall)
                walls[place] = _entry(wall.name, shape, wall.motion, surfaces, bool(kinds)) | {"stiffness": own}
    return {
        "grains": grains,
        "contact": {**_dumped(scene.contact), **contact} if contact else _law(scene.contact),
        "walls": walls,
        "outlet_plane": None if getattr(container, "closed", False) else container.outlet_plane,
        "gravity": scene.gravity,
        **({"feed": {**scene.feed.model_dump(), "version": scene.feed.version}} if scene.feed else {}),
    }


def _surfaces(scene: Scene, wall: Wall | None) -> tuple[Surface, ...]:
    """The surface of a wall for each kind of grains (equal grains are of one); None: of a wall like the grains."""
    kinds = range(len(scene.grains.kinds) or 1)
    return tuple([scene.surface_between(kind, kind) if wall is None else scene.surface(wall, kind) for kind in kinds])


_PLACES: dict[type[WallShape], Callable[[Any], tuple[tuple[float, ...], ...]]] = {
    Plane: attrgetter("normal", "point"),
    Strip: attrgetter("end", "start"),
    Frustum: attrgetter("lower", "upper"),
}
"""What shapes have besides their kind, in the order of canonical JSON."""
_SLOT = Text("\0")  # JSON has no such character


def _wall(wall: Wall, surfaces: tuple[Surface, ...], by_kind: bool) -> Text:
    """`_entry` as canonical JSON. Walls of different containers differ in numbers only: the text around these is made
    once."""
    shape = type(wall.shape)
    if shape not in _PLACES:  # one of another package
        return canonical(_entry(wall.name, wall.shape.model_dump(mode="json"), wall.motion, surfaces, by_kind))
    numbers = [number + 0.0 for place in _PLACES[shape](wall.shape) for number in place]
    return Text(_around(wall.name, shape, wall.motion, surfaces, by_kind) % tuple(numbers))


@once(256)
def _around(
    name: str, shape: type[WallShape], motion: SurfaceMotion, surfaces: tuple[Surface, ...], by_kind: bool
) -> str:
    """The text of a wall with %r in place of the numbers of its shape."""
    size = 3 if shape is Plane else 2
    blank = {key: field.default if key == "kind" else [_SLOT] * size for key, field in shape.model_fields.items()}
    return canonical(_entry(name, blank, motion, surfaces, by_kind)).replace("%", "%%").replace(_SLOT, "%r")


def _entry(
    name: str, shape: dict[str, Any], motion: SurfaceMotion, surfaces: tuple[Surface, ...], by_kind: bool
) -> dict[str, Any]:
    """A wall with its surfaces; `by_kind`: they are listed, also if there is one."""
    found = list(map(_text, surfaces))
    return {"name": name, "shape": shape, "motion": _text(motion), "surface": found if by_kind else found[0]}


@once(512)
def _text(part: Model) -> Text:
    """Canonical JSON of a part that many scenes of a study have in common."""
    return canonical(part.model_dump(mode="json"))


@once(256)
def _law(contact: ContactLaw) -> Text:
    return canonical(_dumped(contact))


def _dumped(contact: ContactLaw) -> dict[str, Any]:
    """A law without the pairs that it states, which count as what they come to."""
    return contact.model_dump(mode="json", exclude={"between"})


def _stiffness(law: ContactLaw, contact: ContactLaw) -> dict[str, Any]:
    """What a contact's law has otherwise than `contact`."""
    return {key: value for key, value in law if value != getattr(contact, key)} if law is not contact else {}


@once(1024)
def numerics_identity(numerics: Numerics) -> Text:
    """The resolved numbers that decide a trajectory, as canonical JSON: all but the guards, which only say when to give
    up."""
    return canonical(numerics.model_dump(mode="json", exclude=set(_GUARDS)))


def guards(numerics: Numerics) -> dict[str, float]:
    """The limits beyond which a run counts as diverged."""
    return {name: getattr(numerics, name) for name in _GUARDS}


@dataclass(frozen=True)
class Filling:
    """How a packing is made: kind of start, its placing's version, when it counts as settled, and the
    seed."""

    kind: str
    seed: int
    settled_below: float
    """Kinetic energy per grain [m g d] below which a packing is at rest."""
    placing: int
    """Version of the rules that place the grains."""
    moving: float = 0.0
    """Fraction of the grains that may still move; part of the key where there is one."""


@dataclass(frozen=True, slots=True)
class Keys:
    """All identities of one run."""

    scene: str
    packing: str
    experiment: str
    """Scene and packing: two backends with the same one ran the same experiment."""
    run: str
    lineage: str
    """As `run`, whatever the backend's version: what a stale run and its replacement have in common."""


@dataclass(frozen=True)
class Maker:
    """What makes a packing: a backend, and the numerics by which it does."""

    backend: Capabilities
    numerics: Numerics


def packing_key(closed: str, filling: Filling, numerics: Numerics, maker: str, cache_version: int) -> str:
    """Key of a packing: key of the closed scene, filling with its seed, resolved numerics, name and version of the
    backend that makes it."""
    return digest({**_packing(closed, filling, numerics, maker), "cache_version": cache_version})


def experiment_key(scene: str, packing: str) -> str:
    """Key of an experiment: keys of the scene and of the packing that it starts from."""
    return digest({"scene": scene, "packing": packing})


def run_key(experiment: str, numerics: Numerics, backend: str, cache_version: int) -> str:
    """Key of a run: that of the experiment, resolved numerics, name and version of the backend."""
    return digest({"experiment": experiment, **_how(numerics, backend), "cache_version": cache_version})


def lineage_key(
    scene: str, closed: str, filling: Filling, numerics: Numerics, backend: str, maker: Maker | None = None
) -> str:
    """As a run's key, but of every version of the backend called `backend`, and of the packing's `maker` (None: the
    backend itself, by the same numerics)."""
    made = (maker.numerics, maker.backend.name) if maker else (numerics, backend)
    return lineage_from(scene, closed, filling, *made, numerics, backend)


def lineage_from(
    scene: str, closed: str, filling: Filling, filled: Numerics, maker: str, numerics: Numerics, backend: str
) -> str:
    """The same where the packing was made by the backend called `maker` with the numerics `filled`."""
    packing = _packing(closed, filling, filled, maker)
    return digest({"scene": scene, "packing": packing, **_how(numerics, backend)})


def run_keys(
    scene: str,
    closed: str,
    filling: Filling,
    numerics: Numerics,
    backend: Capabilities,
    maker: Maker | None = None,
) -> Keys:
    """Identities of a run: keys of the scene and of its closed form, the filling, and how both are
    computed. `maker`: what makes the packing; None: `backend` itself, by the same numerics."""
    made = maker or Maker(backend, numerics)
    packing = packing_key(closed, filling, made.numerics, made.backend.name, made.backend.cache_version)
    experiment = experiment_key(scene, packing)
    run = run_key(experiment, numerics, backend.name, backend.cache_version)
    lineage = lineage_key(scene, closed, filling, numerics, backend.name, made)
    return Keys(scene=scene, packing=packing, experiment=experiment, run=run, lineage=lineage)


def _how(numerics: Numerics, backend: str) -> dict[str, Any]:
    return {"numerics": numerics_identity(numerics), "engine": backend}


def _packing(closed: str, filling: Filling, numerics: Numerics, maker: str) -> dict[str, Any]:
    return {
        "scene": closed,
        "filling": _filling(filling),
        "numerics": numerics_identity(numerics),
        "maker": maker,
    }


@once(256)
def _filling(filling: Filling) -> Text:
    return canonical({name: value for name, value in vars(filling).items() if name != "moving" or value})
