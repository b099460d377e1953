"""Identities: hashes of everything that determines a result, and of nothing else.

A scene counts by its grains, its law, its walls (shape, motion and complete surface) and gravity, not by the words of a
study: two containers with the same walls are one scene. Stop rules, probes, guards, threads, slots and devices are in
no key. They are coverage or provenance.

Formulas of laws and walls count by their `version`, where that is above 1, and those of extensions also by a hash of
their source (`labbook.lab.formulas`). Records have the versions and hashes with which they were made. So their keys can
still be checked when a law or a wall has changed.
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
"""Versions of formulas that are above 1, by `law NAME` and `wall KIND`; for extensions also hashes of their source, by
`source of law NAME` and `source of wall KIND`."""


def versions(scene: Scene) -> dict[str, int | str]:
    """Return the versions and source hashes, as installed, of the law and the walls of a scene."""
    law, result = scene.contact, dict[str, int | str]()
    if law.version > 1:
        result[_LAW + law.law] = law.version
    if law.law in CONTACT_LAWS.extensions:
        result[f"{_SOURCE}{_LAW}{law.law}"] = source_hash(type(law))
    for shape, kind in {type(wall.shape): wall.shape.kind for wall in scene.container.walls()}.items():
        if shape.version > 1:
            result[_WALL + kind] = shape.version
        if kind in WALL_SHAPES.extensions:
            result[f"{_SOURCE}{_WALL}{kind}"] = source_hash(shape)
    return result


def hashed(versions: Versions) -> bool:
    """Return True if there is a source hash: a law or a wall is an extension."""
    return any(name.startswith(_SOURCE) for name in versions)


def numbered(versions: Versions) -> dict[str, int]:
    """Return the versions without source hashes."""
    return {name: version for name, version in versions.items() if isinstance(version, int)}


def older(now: Versions) -> Iterator[Versions]:
    """Yield all combinations of earlier versions of these formulas, the newest first, without hashes."""
    now = numbered(now)
    for combination in product(*(range(version, 0, -1) for version in now.values())):
        candidate = {name: version for name, version in zip(now, combination, strict=True) if version > 1}
        if candidate != now:
            yield candidate


def outdated(recorded: Versions, installed: Versions) -> str:
    """Describe what has changed from the versions `recorded` to those `installed`; empty if nothing has.

    Example: `law hertz-mindlin version 1, now 2: sliding contacts carry mu F_n`.
    """
    newer = {
        name: recorded.get(name, 1) for name, version in numbered(installed).items() if recorded.get(name, 1) != version
    }
    edited = [name for name in installed if name.startswith(_SOURCE) and recorded.get(name) != installed[name]]
    reasons = [_changed(name, int(was), int(installed[name])) for name, was in newer.items()]
    reasons += [_edited(name, name in recorded) for name in edited if name.removeprefix(_SOURCE) not in newer]
    return "; ".join(reasons)


def _edited(source: str, recorded: bool) -> str:
    """Describe a source that has changed, or that was not `recorded` before."""
    entry = source.removeprefix(_SOURCE)
    registry = CONTACT_LAWS if entry.startswith(_LAW) else WALL_SHAPES
    package = registry.extensions[entry.removeprefix(_LAW).removeprefix(_WALL)].package
    if recorded:
        return f"the {entry} of {package} has changed since"
    return f"made before labbook recorded the source of the {entry} of {package}"


def _changed(name: str, recorded: int, installed: int) -> str:
    registry = CONTACT_LAWS if name.startswith(_LAW) else WALL_SHAPES
    changes = registry[name.removeprefix(_LAW).removeprefix(_WALL)].changes
    descriptions = "; ".join(changes[version] for version in range(recorded + 1, installed + 1) if version in changes)
    return f"{name} version {recorded}, now {installed}{descriptions and f': {descriptions}'}"


def scene_key(scene: Scene, versions: Versions | None = None) -> str:
    """Key of a scene: grains, law, walls, motion, gravity, feed and restart.

    Args:
        scene: The scene.
        formula_versions: Versions of law and walls; None: those installed.

    Returns:
        Hexadecimal hash (`labbook.scene.model.digest`).
    """
    return digest(scene_identity(scene, versions))


def scene_identity(scene: Scene, recorded: Versions | None = None) -> dict[str, Any]:
    """Content that `scene_key` hashes.

    Friction, rolling friction and restitution of the law are included, since they act between grains. Parts that many
    scenes share are already canonical JSON.
    """
    recorded = versions(scene) if recorded is None else recorded
    law = _version(recorded, _LAW + scene.contact.law)
    container, kinds = scene.container, range(len(scene.grains.kinds))
    grains: Any = _text(scene.grains)
    contact: dict[str, Any] = {}
    if kinds:  # what acts between them, however it is spelled
        contact["surfaces"] = [[_text(scene.surface_between(a, b)) for b in kinds] for a in kinds]
        kinds_stored = [kind.model_dump(mode="json", exclude=set(OwnMaterial.KEYS)) for kind in scene.grains.kinds]
        grains = {**scene.grains.model_dump(mode="json"), "kinds": kinds_stored}
    walls: Any
    if scene.has_own_stiffness:
        walls, species = _walls(scene, recorded), range(len(scene.grains.species))
        pairs = [[_stiffness(scene.law_between(a, b), scene.contact) for b in species] for a in species]
        contact |= {"stiffness": pairs} if any(map(any, pairs)) else {}
        for entry, wall in zip(walls, container.walls(), strict=True):
            if any(own := [_stiffness(scene.law(wall, kind), scene.contact) for kind in species]):
                entry["stiffness"] = own
    else:
        walls = _written_walls(scene, recorded)
    return {
        "grains": grains,
        "contact": {**_dumped(scene.contact), **law, **contact} if contact else _law(scene.contact, tuple(law.items())),
        "walls": walls,
        "outlet_plane": scene.outlet,
        "gravity": scene.gravity,
        # Parts that a scene lacks are left out: scenes from before they existed keep their keys.
        **({} if scene.sink is None else {"sink": scene.sink}),
        **({"planes": [plane.model_dump() for plane in planes]} if (planes := scene.container.planes) else {}),
        **({"zones": [zone.model_dump() for zone in zones]} if (zones := scene.container.zones) else {}),
        **({"feed": {**scene.feed.model_dump(), "version": scene.feed.version}} if scene.feed else {}),
        **({"restart": {**scene.restart.model_dump(), "version": scene.restart.version}} if scene.restart else {}),
    }


def _walls(scene: Scene, versions: Versions) -> list[dict[str, Any]]:
    """The walls of a scene, each with its surface."""
    by_kind = bool(scene.grains.kinds)
    return [
        _wall(wall.name, _shape(wall.shape, versions), wall.motion, _surfaces(scene, wall), by_kind)
        | ({} if wall.moves is None else {"moves": _text(wall.moves)})
        | ({} if wall.removal is None else {"opens": wall.removal})
        for wall in scene.container.walls()
    ]


def _shape(shape: WallShape, versions: Versions) -> dict[str, Any]:
    return shape.model_dump(mode="json") | _version(versions, _WALL + shape.kind)


def _version(versions: Versions, name: str) -> dict[str, int | str]:
    """Version and source hash of a law or a wall, as the key has them beside its parameters."""
    # no parameter of a law or a wall has a space in its name
    entries = {"version": versions.get(name), "source hash": versions.get(_SOURCE + name)}
    return {key: value for key, value in entries.items() if value is not None}


def _wall(
    name: str, shape: dict[str, Any], motion: SurfaceMotion, surfaces: tuple[Surface, ...], by_kind: bool
) -> dict[str, Any]:
    """Entry of one wall; `by_kind`: list the surface for each kind of grains, even for a single kind."""
    surface_texts = list(map(_text, surfaces))
    return {
        "name": name,
        "shape": shape,
        "motion": _text(motion),
        "surface": surface_texts if by_kind else surface_texts[0],
    }


def _surfaces(scene: Scene, wall: Wall) -> tuple[Surface, ...]:
    """Surface of a wall for each kind of grains; one surface if there are no kinds."""
    return tuple([scene.surface(wall, kind) for kind in range(len(scene.grains.kinds) or 1)])


_PLACES: dict[type[WallShape], Callable[[Any], tuple[tuple[float, ...], ...]]] = {
    Plane: attrgetter("normal", "point"),
    Strip: attrgetter("end", "start"),
    Frustum: attrgetter("lower", "upper"),
}
"""Parameters of the shapes beside their kind, in the order of canonical JSON."""
_SLOT = Text("\0")  # JSON has no such character


def _written_walls(scene: Scene, versions: Versions) -> Text:
    """`_walls` as canonical JSON, made quickly.

    The containers of a study differ only in the numbers of their walls: the text around these is cached.
    """
    walls = scene.container.walls()
    plain = all([type(wall.shape) in _PLACES for wall in walls])  # not of another package
    if not plain or any(_WALL in name for name in versions):
        return canonical(_walls(scene, versions))
    blank = tuple([(wall.name, type(wall.shape), wall.motion) for wall in walls])
    if scene.walls:
        surfaces = tuple([_surfaces(scene, wall) for wall in walls])
    else:  # all walls are like the grains
        surfaces = tuple([_surfaces(scene, wall) for wall in walls[:1]])
    positions = [position for wall in walls for position in _PLACES[type(wall.shape)](wall.shape)]
    numbers = [number + 0.0 for position in positions for number in position]  # + 0.0: canonical JSON has no -0.0
    return Text(_around(blank, surfaces, bool(scene.grains.kinds)) % tuple(numbers))


@once(256)
def _around(
    walls: tuple[tuple[str, type[WallShape], SurfaceMotion], ...],
    surfaces: tuple[tuple[Surface, ...], ...],
    by_kind: bool,
) -> str:
    """JSON text of walls with `%r` in place of the numbers of their shapes; `surfaces`: for each wall, or one for
    all."""
    entries = list[dict[str, Any]]()
    for index, (name, shape, motion) in enumerate(walls):
        size = 3 if shape is Plane else 2
        blank = {key: field.default if key == "kind" else [_SLOT] * size for key, field in shape.model_fields.items()}
        entries.append(_wall(name, blank, motion, surfaces[index % len(surfaces)], by_kind))
    return canonical(entries).replace("%", "%%").replace(_SLOT, "%r")  # names of walls may have a percent sign


@once(512)
def _text(part: Model) -> Text:
    """Canonical JSON of a part that many scenes of a study share."""
    return canonical(part.model_dump(mode="json"))


@once(256)
def _law(contact: ContactLaw, version: tuple[tuple[str, int | str], ...]) -> Text:
    return canonical(_dumped(contact) | dict(version))


def _dumped(contact: ContactLaw) -> dict[str, Any]:
    """A law as JSON without the pairs that it states: the resolved surfaces and stiffnesses count instead."""
    return contact.model_dump(mode="json", exclude={"between"})


def _stiffness(law: ContactLaw, contact: ContactLaw) -> dict[str, Any]:
    """Parameters of the law of one contact that differ from those of `contact`."""
    return {key: value for key, value in law if value != getattr(contact, key)} if law is not contact else {}


@once(1024)
def numerics_identity(numerics: Numerics) -> Text:
    """Canonical JSON of the resolved numerics that determine a trajectory.

    The guards are left out: they only decide when a run is given up.
    """
    return canonical(numerics.model_dump(mode="json", exclude=set(_GUARDS)))


def guards(numerics: Numerics) -> dict[str, float]:
    """Return the limits beyond which a run counts as diverged."""
    return {name: getattr(numerics, name) for name in _GUARDS}


@dataclass(frozen=True)
class Filling:
    """Preparation of a packing: start, placing rules, criterion of rest, and seed."""

    kind: str
    seed: int
    settled_below: float
    """Kinetic energy per grain [m g d] below which the packing counts as settled."""
    placing: int
    """Version of the rules that place the grains."""
    moving: float = 0.0
    """Fraction of the grains that may still move; in the key unless it is 0."""
    file: Annotated[GrainFile | None, Field(exclude_if=lambda file: file is None)] = None
    """File of the grains; in the key if there is one."""
    mobilise: Annotated[Mobilise | None, Field(exclude_if=lambda mobilise: mobilise is None)] = None
    """Motion of the bottom against the upright walls after settling; in the key if there is one."""
    stream: Annotated[Stream | None, Field(exclude_if=lambda stream: stream is None)] = None
    """Stream by which grains enter; in the key if there is one."""
    until: Annotated[float | None, Field(exclude_if=lambda until: until is None)] = None
    """Time [s] at which the filling ends, settled or not; in the key if it is stated."""


@dataclass(frozen=True, slots=True)
class Keys:
    """All identities of one run."""

    scene: str
    packing: str
    experiment: str
    """Key of scene, packing and kick: two backends with the same one ran the same experiment."""
    run: str
    lineage: str
    """Key without the backend's version and source hashes: an outdated run and its replacement share it."""


@dataclass(frozen=True)
class Maker:
    """Backend and numerics with which a packing is made."""

    backend: Capabilities
    numerics: Numerics


def packing_key(closed: str, filling: Filling, numerics: Numerics, maker: str, cache_version: int) -> str:
    """Key of a packing.

    Args:
        closed: Key of the closed scene.
        filling: Preparation, with its seed.
        numerics: Resolved numerics of the filling.
        maker: Name of the backend that makes it.
        cache_version: Version of that backend.
    """
    return digest({**_packing(closed, filling, numerics, maker), "cache_version": cache_version})


def experiment_key(scene: str, packing: str, kick: Kick | None = None) -> str:
    """Key of an experiment.

    Args:
        scene: Key of the scene.
        packing: Key of the packing from which it starts.
        kick: Kick of a discharge after the first of its bed.
    """
    return digest({"scene": scene, "packing": packing, **_kick(kick)})


def run_key(experiment: str, numerics: Numerics, backend: str, cache_version: int) -> str:
    """Key of a run: that of its experiment, resolved numerics, name and version of the backend."""
    return digest({"experiment": experiment, **_how(numerics, backend), "cache_version": cache_version})


def lineage_scene(scene: Scene, versions: Versions, key: str) -> str:
    """Key of a scene as lineages use it: by `versions` without source hashes. `key`: the key with them."""
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
    """Key of a run's lineage: as the run's key, but without versions of the backend and of the packing's `maker`.

    `maker` None: the backend itself makes the packing, with the same numerics.
    """
    packing_maker = (maker.numerics, maker.backend.name) if maker else (numerics, backend)
    return lineage_from(scene, closed, filling, *packing_maker, numerics, backend, kick)


def lineage_from(
    scene: str,
    closed: str,
    filling: Filling,
    filling_numerics: Numerics,
    maker: str,
    numerics: Numerics,
    backend: str,
    kick: Kick | None = None,
) -> str:
    """Key of a lineage whose packing the backend `maker` made with the numerics `filling_numerics`."""
    packing = _packing(closed, filling, filling_numerics, maker)
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
    """Compute all keys of a run.

    Args:
        scene: Key of the scene.
        closed: Key of the closed scene of the filling.
        filling: Preparation of the packing.
        numerics: Resolved numerics of the run.
        backend: Backend of the run.
        maker: Backend and numerics of the packing; None: those of the run.
        lineage_scenes: Keys of both scenes as lineages use them (`lineage_scene`), where they differ.
        kick: Kick of a discharge after the first of its bed.
    """
    packing_maker = maker or Maker(backend, numerics)
    packing = packing_key(
        closed, filling, packing_maker.numerics, packing_maker.backend.name, packing_maker.backend.cache_version
    )
    experiment = experiment_key(scene, packing, kick)
    run = run_key(experiment, numerics, backend.name, backend.cache_version)
    lineage = lineage_key(*(lineage_scenes or (scene, closed)), filling, numerics, backend.name, packing_maker, kick)
    return Keys(scene=scene, packing=packing, experiment=experiment, run=run, lineage=lineage)


def _how(numerics: Numerics, backend: str) -> dict[str, Any]:
    # `engine` is the stored name of the backend: another word would change every key.
    return {"numerics": numerics_identity(numerics), "engine": backend}


def _kick(kick: Kick | None) -> dict[str, Any]:
    """Entry of the kick in a key; a first discharge has none."""
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
    # Left out at their default: fillings from before they existed keep their keys.
    optional = ("moving", "file", "mobilise", "stream", "until")
    parts = {name: value for name, value in vars(filling).items() if name not in optional or value}
    if filling.until is not None:  # 0 s is stated too, although it is false
        parts["until"] = filling.until
    if filling.stream is not None:
        parts["stream"] = filling.stream.model_dump(mode="json") | {"version": pouring.VERSION}
    if filling.file is not None:
        parts["file"] = asdict(filling.file)
    if filling.mobilise is not None:
        parts["mobilise"] = filling.mobilise.model_dump()
    return canonical(parts)
