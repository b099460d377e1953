"""Identities: hashes of what decides a result, and of nothing else.

A scene counts by its grains, its law, its walls (shape, motion and complete surface) and gravity, not by how
a study spells them: two containers that amount to the same walls are one scene. Stop rules, probes, guards,
threads, slots and devices are no part of any key; they are coverage or provenance.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from labbook.backend import Capabilities
from labbook.backend.numerics import Numerics
from labbook.scene import ContactLaw, Scene, Surface, Wall
from labbook.scene.container import KEPT
from labbook.scene.material import OwnMaterial
from labbook.scene.model import digest, plain

_GUARDS = ("speed_limit", "overlap_limit")


def scene_key(scene: Scene) -> str:
    """Key of what is simulated: grains, law, walls, motion, gravity, feed."""
    return digest(scene_identity(scene))


def scene_identity(scene: Scene) -> dict[str, Any]:
    """What `scene_key` hashes. A law's friction, rolling friction and restitution are kept: they act between
    grains."""
    container = scene.container
    dumped = _dumped(container.walls())
    walls = [
        {**entry, "surface": _surface(scene.surface(wall))}
        for wall, entry in zip(container.walls(), dumped, strict=True)
    ]
    contact = scene.contact.model_dump(mode="json", exclude={"between"})
    grains = scene.grains.model_dump(mode="json")
    kinds = range(len(scene.grains.kinds))
    if kinds:  # what acts between them, however it is spelled
        contact["surfaces"] = [[_surface(scene.surface_between(a, b)) for b in kinds] for a in kinds]
        for entry, wall in zip(walls, container.walls(), strict=True):
            entry["surface"] = [_surface(scene.surface(wall, kind)) for kind in kinds]
        grains["kinds"] = [kind.model_dump(mode="json", exclude=set(OwnMaterial.KEYS)) for kind in scene.grains.kinds]
    _add_stiffness(scene, contact, walls)
    return {
        "grains": grains,
        "contact": contact,
        "walls": walls,
        "outlet_plane": None if getattr(container, "closed", False) else container.outlet_plane,
        "gravity": scene.gravity,
        **({"feed": {**scene.feed.model_dump(), "version": scene.feed.version}} if scene.feed else {}),
    }


@lru_cache(maxsize=KEPT)
def _dumped(walls: tuple[Wall, ...]) -> tuple[dict[str, Any], ...]:
    """Walls as plain values, which nobody changes."""
    dumped = (wall.model_dump(mode="json") for wall in walls)
    return tuple({key: plain(one) if isinstance(one, dict) else one for key, one in wall.items()} for wall in dumped)


def _add_stiffness(scene: Scene, contact: dict[str, Any], walls: list[dict[str, Any]]) -> None:
    """To `contact` and to `walls` the stiffness of their contacts, kind by kind, where it is not the law's."""
    if not scene.has_own_stiffness:
        return
    kinds = range(len(scene.grains.species))
    pairs = [[_stiffness(scene.law_between(a, b), scene.contact) for b in kinds] for a in kinds]
    if any(map(any, pairs)):
        contact["stiffness"] = pairs
    for entry, wall in zip(walls, scene.container.walls(), strict=True):
        if any(own := [_stiffness(scene.law(wall, kind), scene.contact) for kind in kinds]):
            entry["stiffness"] = own


def _stiffness(law: ContactLaw, contact: ContactLaw) -> dict[str, Any]:
    """What a contact's law has otherwise than `contact`."""
    return {key: value for key, value in law if value != getattr(contact, key)} if law is not contact else {}


def _surface(surface: Surface) -> dict[str, Any]:
    return surface.model_dump(mode="json")


def numerics_identity(numerics: Numerics) -> dict[str, Any]:
    """The resolved numbers that decide a trajectory: all but the guards, which only say when to give up."""
    return numerics.model_dump(mode="json", exclude=set(_GUARDS))


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


@dataclass(frozen=True)
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
        "filling": {name: value for name, value in vars(filling).items() if name != "moving" or value},
        "numerics": numerics_identity(numerics),
        "maker": maker,
    }
