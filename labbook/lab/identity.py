"""Identities: hashes of what decides a result, and of nothing else.

A scene counts by its grains, its law, its walls (shape, motion and complete surface) and gravity, not by how
a study spells them: two containers that amount to the same walls are one scene. Stop rules, probes, guards,
threads, slots and devices are no part of any key; they are coverage or provenance.

Formulas of laws and walls count by their `version`, where that is above 1, and those of extensions also by a hash of
their source (`labbook.lab.formulas`). Records say by which versions and hashes they were made. So their keys can be
checked when a law or a wall has changed.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import product
from operator import attrgetter
from typing import Annotated, Any

from pydantic import Field

from labbook.backend import Capabilities
from labbook.backend.numerics import Numerics
from labbook.filling import GrainFile, Kick, Mobilise, pouring
from labbook.lab.formulas import source_hash
from labbook.scene import CONTACT_LAWS, ContactLaw, Scene, Surface, Wall
from labbook.scene.material import OwnMaterial
from labbook.scene.model import Model, Text, canonical, digest, once
from labbook.scene.stream import Stream
from labbook.scene.walls import WALL_SHAPES, Frustum, Plane, Strip, SurfaceMotion, WallShape

_GUARDS = ("speed_limit", "overlap_limit")
_LAW, _WALL, _SOURCE = "law ", "wall ", "source of "

Versions = Mapping[str, int | str]
"""Versions of formulas that are above 1, by `law NAME` and `wall KIND`; of extensions also hashes of their source, by
`source of law NAME` and `source of wall KIND`."""


def versions(scene: Scene) -> dict[str, int | str]:
    """Versions and hashes, as installed, of the law and of the walls of a scene."""
    law, found = scene.contact, dict[str, int | str]()
    if law.version > 1:
        found[_LAW + law.law] = law.version
    if law.law in CONTACT_LAWS.extensions:
        found[f"{_SOURCE}{_LAW}{law.law}"] = source_hash(type(law))
    for shape, kind in {type(wall.shape): wall.shape.kind for wall in scene.container.walls()}.items():
        if shape.version > 1:
            found[_WALL + kind] = shape.version
        if kind in WALL_SHAPES.extensions:
            found[f"{_SOURCE}{_WALL}{kind}"] = source_hash(shape)
    return found


def hashed(versions: Versions) -> bool:
    """True if a hash is among these: a law or a wall is an extension."""
    return any(name.startswith(_SOURCE) for name in versions)


def numbered(versions: Versions) -> dict[str, int]:
    """The versions among these, without hashes."""
    return {name: version for name, version in versions.items() if isinstance(version, int)}


def older(now: Versions) -> Iterator[Versions]:
    """All that the versions among these may have been before, the newest first, without hashes."""
    now = numbered(now)
    for each in product(*(range(version, 0, -1) for version in now.values())):
        made = {name: version for name, version in zip(now, each, strict=True) if version > 1}
        if made != now:
            yield made


def outdated(made: Versions, now: Versions) -> str:
    """What has changed since something was made by the versions `made`: `law hertz-mindlin version 1, now 2: sliding
    contacts carry mu F_n`; empty if nothing."""
    newer = {name: made.get(name, 1) for name, version in numbered(now).items() if made.get(name, 1) != version}
    edited = [name for name in now if name.startswith(_SOURCE) and made.get(name) != now[name]]
    reasons = [_changed(name, int(was), int(now[name])) for name, was in newer.items()]
    reasons += [_edited(name, name in made) for name in edited if name.removeprefix(_SOURCE) not in newer]
    return "; ".join(reasons)


def _edited(source: str, recorded: bool) -> str:
    """The words for a source that has changed, or that was not `recorded` before."""
    entry = source.removeprefix(_SOURCE)
    registry = CONTACT_LAWS if entry.startswith(_LAW) else WALL_SHAPES
    package = registry.extensions[entry.removeprefix(_LAW).removeprefix(_WALL)].package
    if recorded:
        return f"the {entry} of {package} has changed since"
    return f"made before labbook recorded the source of the {entry} of {package}"


def _changed(name: str, was: int, now: int) -> str:
    known = CONTACT_LAWS if name.startswith(_LAW) else WALL_SHAPES
    changes = known[name.removeprefix(_LAW).removeprefix(_WALL)].changes
    what = "; ".join(changes[version] for version in range(was + 1, now + 1) if version in changes)
    return f"{name} version {was}, now {now}{what and f': {what}'}"


def scene_key(scene: Scene, made: Versions | None = None) -> str:
    """Key of what is simulated: grains, law, walls, motion, gravity, feed, restart. `made`: versions of law and walls;
    None: as installed."""
    return digest(scene_identity(scene, made))


def scene_identity(scene: Scene, made: Versions | None = None) -> dict[str, Any]:
    """What `scene_key` hashes. A law's friction, rolling friction and restitution are kept: they act between
    grains. Parts that many scenes have in common are canonical JSON already."""
    made = versions(scene) if made is None else made
    law = _version(made, _LAW + scene.contact.law)
    container, kinds = scene.container, range(len(scene.grains.kinds))
    grains: Any = _text(scene.grains)
    contact: dict[str, Any] = {}
    if kinds:  # what acts between them, however it is spelled
        contact["surfaces"] = [[_text(scene.surface_between(a, b)) for b in kinds] for a in kinds]
        stated = [kind.model_dump(mode="json", exclude=set(OwnMaterial.KEYS)) for kind in scene.grains.kinds]
        grains = {**scene.grains.model_dump(mode="json"), "kinds": stated}
    walls: Any
    if scene.has_own_stiffness:
        walls, sorts = _walls(scene, made), range(len(scene.grains.species))
        pairs = [[_stiffness(scene.law_between(a, b), scene.contact) for b in sorts] for a in sorts]
        contact |= {"stiffness": pairs} if any(map(any, pairs)) else {}
        for entry, wall in zip(walls, container.walls(), strict=True):
            if any(own := [_stiffness(scene.law(wall, kind), scene.contact) for kind in sorts]):
                entry["stiffness"] = own
    else:
        walls = _written_walls(scene, made)
    return {
        "grains": grains,
        "contact": {**_dumped(scene.contact), **law, **contact} if contact else _law(scene.contact, tuple(law.items())),
        "walls": walls,
        "outlet_plane": scene.outlet,
        "gravity": scene.gravity,
        **({} if scene.sink is None else {"sink": scene.sink}),
        **({"planes": [plane.model_dump() for plane in planes]} if (planes := scene.container.planes) else {}),
        **({"feed": {**scene.feed.model_dump(), "version": scene.feed.version}} if scene.feed else {}),
        **({"restart": {**scene.restart.model_dump(), "version": scene.restart.version}} if scene.restart else {}),
    }


def _walls(scene: Scene, made: Versions) -> list[dict[str, Any]]:
    """The walls of a scene, each with its surface."""
    by_kind = bool(scene.grains.kinds)
    return [
        _wall(wall.name, _shape(wall.shape, made), wall.motion, _surfaces(scene, wall), by_kind)
        | ({} if wall.moves is None else {"moves": _text(wall.moves)})
        | ({} if wall.removal is None else {"opens": wall.removal})
        for wall in scene.container.walls()
    ]


def _shape(shape: WallShape, made: Versions) -> dict[str, Any]:
    return shape.model_dump(mode="json") | _version(made, _WALL + shape.kind)


def _version(versions: Versions, name: str) -> dict[str, int | str]:
    """Version and hash of a law or a wall, as they stand beside its parameters."""
    # no parameter of a law or a wall has a space in its name
    entries = {"version": versions.get(name), "source hash": versions.get(_SOURCE + name)}
    return {key: value for key, value in entries.items() if value is not None}


def _wall(
    name: str, shape: dict[str, Any], motion: SurfaceMotion, surfaces: tuple[Surface, ...], by_kind: bool
) -> dict[str, Any]:
    """`by_kind`: the surface of each kind of grains is listed, also if there is one kind."""
    found = list(map(_text, surfaces))
    return {"name": name, "shape": shape, "motion": _text(motion), "surface": found if by_kind else found[0]}


def _surfaces(scene: Scene, wall: Wall) -> tuple[Surface, ...]:
    """The surface of a wall for each kind of grains; equal grains are of one."""
    return tuple([scene.surface(wall, kind) for kind in range(len(scene.grains.kinds) or 1)])


_PLACES: dict[type[WallShape], Callable[[Any], tuple[tuple[float, ...], ...]]] = {
    Plane: attrgetter("normal", "point"),
    Strip: attrgetter("end", "start"),
    Frustum: attrgetter("lower", "upper"),
}
"""What shapes have besides their kind, in the order of canonical JSON."""
_SLOT = Text("\0")  # JSON has no such character


def _written_walls(scene: Scene, made: Versions) -> Text:
    """`_walls` as canonical JSON. Of the containers of a study only the numbers of walls differ: the text around these
    is made once."""
    walls = scene.container.walls()
    plain = all([type(wall.shape) in _PLACES for wall in walls])  # not of another package
    if not plain or any(_WALL in name for name in made):
        return canonical(_walls(scene, made))
    blank = tuple([(wall.name, type(wall.shape), wall.motion) for wall in walls])
    if scene.walls:
        surfaces = tuple([_surfaces(scene, wall) for wall in walls])
    else:  # all walls are like the grains
        surfaces = tuple([_surfaces(scene, wall) for wall in walls[:1]])
    places = [place for wall in walls for place in _PLACES[type(wall.shape)](wall.shape)]
    numbers = [number + 0.0 for place in places for number in place]
    return Text(_around(blank, surfaces, bool(scene.grains.kinds)) % tuple(numbers))


@once(256)
def _around(
    walls: tuple[tuple[str, type[WallShape], SurfaceMotion], ...],
    surfaces: tuple[tuple[Surface, ...], ...],
    by_kind: bool,
) -> str:
    """The text of walls, by their names, shapes and motions, with %r in place of the numbers of their shapes.
    `surfaces`: those of each wall, or of all of them."""
    entries = list[dict[str, Any]]()
    for place, (name, shape, motion) in enumerate(walls):
        size = 3 if shape is Plane else 2
        blank = {key: field.default if key == "kind" else [_SLOT] * size for key, field in shape.model_fields.items()}
        entries.append(_wall(name, blank, motion, surfaces[place % len(surfaces)], by_kind))
    return canonical(entries).replace("%", "%%").replace(_SLOT, "%r")


@once(512)
def _text(part: Model) -> Text:
    """Canonical JSON of a part that many scenes of a study have in common."""
    return canonical(part.model_dump(mode="json"))


@once(256)
def _law(contact: ContactLaw, version: tuple[tuple[str, int | str], ...]) -> Text:
    return canonical(_dumped(contact) | dict(version))


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
    file: Annotated[GrainFile | None, Field(exclude_if=lambda file: file is None)] = None
    """File of the grains; part of the key where there is one."""
    mobilise: Annotated[Mobilise | None, Field(exclude_if=lambda mobilise: mobilise is None)] = None
    """Motion of the bottom against the upright walls after the rest; part of the key where there is one."""
    stream: Annotated[Stream | None, Field(exclude_if=lambda stream: stream is None)] = None
    """Stream by which grains enter; part of the key where there is one."""
    until: Annotated[float | None, Field(exclude_if=lambda until: until is None)] = None
    """Time [s] at which the filling ends, whether the bed rests or not; part of the key where it is stated."""


@dataclass(frozen=True, slots=True)
class Keys:
    """All identities of one run."""

    scene: str
    packing: str
    experiment: str
    """Scene, packing and kick: two backends with the same one ran the same experiment."""
    run: str
    lineage: str
    """As `run`, whatever the backend's version and the source of extensions: what a stale run and its replacement have
    in common."""


@dataclass(frozen=True)
class Maker:
    """What makes a packing: a backend, and the numerics by which it does."""

    backend: Capabilities
    numerics: Numerics


def packing_key(closed: str, filling: Filling, numerics: Numerics, maker: str, cache_version: int) -> str:
    """Key of a packing: key of the closed scene, filling with its seed, resolved numerics, name and version of the
    backend that makes it."""
    return digest({**_packing(closed, filling, numerics, maker), "cache_version": cache_version})


def experiment_key(scene: str, packing: str, kick: Kick | None = None) -> str:
    """Key of an experiment: keys of the scene and of the packing that it starts from, and the kick, if it has one."""
    return digest({"scene": scene, "packing": packing, **_kick(kick)})


def run_key(experiment: str, numerics: Numerics, backend: str, cache_version: int) -> str:
    """Key of a run: that of the experiment, resolved numerics, name and version of the backend."""
    return digest({"experiment": experiment, **_how(numerics, backend), "cache_version": cache_version})


def lineage_scene(scene: Scene, versions: Versions, key: str) -> str:
    """The key of a scene as lineages have it: by `versions` without their hashes. `key`: that by all of them."""
    return scene_key(scene, numbered(versions)) if hashed(versions) else key


def lineage_key(
    scene: str,
    closed: str,
    filling: Filling,
    numerics: Numerics,
    backend: str,
    maker: Maker | None = None,
    kick: Kick | None = None,
) -> str:
    """As a run's key, but of every version of the backend called `backend`, and of the packing's `maker` (None: the
    backend itself, by the same numerics)."""
    made = (maker.numerics, maker.backend.name) if maker else (numerics, backend)
    return lineage_from(scene, closed, filling, *made, numerics, backend, kick)


def lineage_from(
    scene: str,
    closed: str,
    filling: Filling,
    filled: Numerics,
    maker: str,
    numerics: Numerics,
    backend: str,
    kick: Kick | None = None,
) -> str:
    """The same where the packing was made by the backend called `maker` with the numerics `filled`."""
    packing = _packing(closed, filling, filled, maker)
    return digest({"scene": scene, "packing": packing, **_how(numerics, backend), **_kick(kick)})


def run_keys(
    scene: str,
    closed: str,
    filling: Filling,
    numerics: Numerics,
    backend: Capabilities,
    maker: Maker | None = None,
    lineage_scenes: tuple[str, str] | None = None,
    kick: Kick | None = None,
) -> Keys:
    """Identities of a run: keys of the scene and of its closed form, the filling, and how both are
    computed. `maker`: what makes the packing; None: `backend` itself, by the same numerics. `lineage_scenes`: keys of
    both scenes as lineages have them (`lineage_scene`), where they differ. `kick`: of a discharge after the first of
    its bed."""
    made = maker or Maker(backend, numerics)
    packing = packing_key(closed, filling, made.numerics, made.backend.name, made.backend.cache_version)
    experiment = experiment_key(scene, packing, kick)
    run = run_key(experiment, numerics, backend.name, backend.cache_version)
    lineage = lineage_key(*(lineage_scenes or (scene, closed)), filling, numerics, backend.name, made, kick)
    return Keys(scene=scene, packing=packing, experiment=experiment, run=run, lineage=lineage)


def _how(numerics: Numerics, backend: str) -> dict[str, Any]:
    return {"numerics": numerics_identity(numerics), "engine": backend}


def _kick(kick: Kick | None) -> dict[str, Any]:
    """The kick as it stands in a key, from which the first discharge of a bed leaves it out."""
    return {} if kick is None else {"kick": vars(kick)}


def _packing(closed: str, filling: Filling, numerics: Numerics, maker: str) -> dict[str, Any]:
    return {
        "scene": closed,
        "filling": _filling(filling),
        "numerics": numerics_identity(numerics),
        "maker": maker,
    }


@once(256)
def _filling(filling: Filling) -> Text:
    optional = ("moving", "file", "mobilise", "stream", "until")
    parts = {name: value for name, value in vars(filling).items() if name not in optional or value}
    if filling.until is not None:
        parts["until"] = filling.until
    if filling.stream is not None:
        parts["stream"] = filling.stream.model_dump(mode="json") | {"version": pouring.VERSION}
    if filling.file is not None:
        parts["file"] = asdict(filling.file)
    if filling.mobilise is not None:
        parts["mobilise"] = filling.mobilise.model_dump()
    return canonical(parts)
