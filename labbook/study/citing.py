"""Bibliography of a study: labbook, and the published sources of the laws, measures and methods that it uses."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from labbook import sources
from labbook.filling.placing import STARTS
from labbook.fit import LAWS
from labbook.measure import MEASURES
from labbook.scene import Clumps, LinearSpringDashpot, LogNormal, Scene, Spherocylinders, WedgeHopper
from labbook.scene.contact import CONTACT_LAWS, ContactLaw
from labbook.sources import METHODS, SOURCES, Source, named_in
from labbook.study.load import Study
from labbook.study.paper import PAPERS
from labbook.version import __version__

AUTHORS = "The labbook authors"
ANGLE = "container.angle"


@dataclass(frozen=True)
class Citation:
    """A source, and what the study uses of it."""

    source: Source
    uses: tuple[str, ...]


@dataclass(frozen=True)
class Bibliography:
    """The sources of a study, labbook first, then in the order in which the study uses them.

    `unsourced`: parts of the study from other packages that state no source.
    """

    citations: tuple[Citation, ...]
    unsourced: tuple[str, ...] = ()


def itself() -> Source:
    """labbook as a source, with the version in use."""
    return Source("labbook", "labbook", (AUTHORS,), version=__version__)


def bibliography(study: Study) -> Bibliography:
    """Collect the sources to cite for a study.

    Args:
        study: The study; it needs no finished run.

    Returns:
        The sources with their uses, and the uses without a stated source.

    Raises:
        BrokenPlugin: The study uses a package that cannot be loaded.
    """
    cited: dict[str, Source] = {}
    uses: dict[str, list[str]] = {}
    unsourced = []
    for use, published in _uses(study):
        if published is None:
            unsourced.append(use)
        for source in published or ():
            key = _key(source, cited)
            cited[key] = source if key == source.key else Source(**{**vars(source), "key": key})
            uses.setdefault(key, []).append(use)
    citations = (Citation(source, tuple(dict.fromkeys(uses[key]))) for key, source in cited.items())
    return Bibliography(tuple(citations), tuple(dict.fromkeys(unsourced)))


def _key(source: Source, cited: Mapping[str, Source]) -> str:
    """A key that no other source has: that of the source, with a number behind it where it is taken."""
    key, number = source.key, 1
    while key in cited and cited[key].title != source.title:
        number += 1
        key = f"{source.key}-{number}"
    return key


_Used = tuple[str, Iterable[Source] | None]
"""Something that a study uses, and its sources; None where its package states none."""


def _uses(study: Study) -> Iterator[_Used]:
    yield "all results", [itself()]
    yield from _contacts(study)
    scenes = [point.scene for point in study.points]
    if any(isinstance(scene.grains, Spherocylinders) and not scene.grains.round for scene in scenes):
        yield _method("contacts of rods")
    if any(isinstance(scene.grains, Clumps) for scene in scenes):
        yield _method("motion of clumps")
    if any(isinstance(sort.sizes, LogNormal) and sort.sizes.by == "mass" for s in scenes for sort in s.grains.species):
        yield _method("log-normal sizes by mass")
    for start in dict.fromkeys(point.fill.kind for point in study.points):
        yield _listed(f"filling {start}", start, STARTS[start], sources.STARTS)
    for name in study.measure:
        yield _listed(f"measure {name}", name, MEASURES[name], sources.MEASURES)
    if "packing" in study.measure and any(_hexatic(scene) for scene in scenes):
        yield _method("hexatic order")
    if study.record is not None:
        yield _method("fields of recorded runs")
    yield from _fits(study)
    yield from _statistics(study)
    if _compares_angles(study):
        yield _method("flow rate against the angle of the bottom")
    yield from _references(study)


def _contacts(study: Study) -> Iterator[_Used]:
    laws: list[ContactLaw] = []
    for point in study.points:
        laws += [law for law in (point.scene.contact, point.fill.contact) if law is not None]
    for name in dict.fromkeys(law.law for law in laws):
        yield _listed(f"contact law {name}", name, CONTACT_LAWS[name], sources.CONTACT_LAWS)
    if any(isinstance(law, LinearSpringDashpot) and law.damping == "clamped" for law in laws):
        yield _method("restitution of the law linear")
    rolling = (point.scene for point in study.points)
    for model in dict.fromkeys(scene.contact.rolling_model for scene in rolling if _rolls(scene)):
        yield f"rolling friction {model}", [SOURCES[key] for key in sources.ROLLING_MODELS[model]]


def _fits(study: Study) -> Iterator[_Used]:
    laws = [name for name in study.fit if name in LAWS]
    for name in laws:
        yield f"fit {name}", _own_sources(LAWS[name])
    if laws:
        yield _method("confidence intervals of fits")
    if len(laws) > 1:
        yield _method("choice between laws")
    for name in (name for name in study.fit if name not in LAWS):
        paper = next(paper for paper in PAPERS.values() if name in paper.fits)
        yield _listed(f"fit {name}", name, paper, sources.PAPER_FITS)


def _statistics(study: Study) -> Iterator[_Used]:
    swept = any(key.startswith("numerics.") for point in study.points for key in point.at)
    if study.accuracy.numerics is not None and swept:
        yield _method("equivalence tests of numerics")
    if study.fed:
        yield _method("error of the flow rate within a run")


def _references(study: Study) -> Iterator[_Used]:
    if study.reference is None:
        return
    yield f"reference ({' '.join(study.reference.source.split())})", named_in(study.reference.source)
    published = (*study.reference.entries, *study.reference.statements)
    heads = {one.quantity.partition(".")[0] for one in published} - {*MEASURES, *LAWS}
    for paper in PAPERS.values() if heads else ():
        if heads & set(paper.words):
            yield f"analysis of {paper.name}", [SOURCES[paper.name]] if paper.name in SOURCES else _own_sources(paper)


def _listed(use: str, name: str, one: Any, table: Mapping[str, tuple[str, ...]]) -> _Used:
    """Sources that `table` lists for a name; for an extension of another package those that it states itself."""
    return use, [SOURCES[key] for key in table[name]] if name in table else _own_sources(one)


def _own_sources(extension: Any) -> tuple[Source, ...] | None:
    """The sources in the text `source` of a class or object; None without one."""
    text = getattr(extension, "source", "")
    return named_in(text) if isinstance(text, str) and text.strip() else None


def _method(name: str) -> _Used:
    return name, [SOURCES[key] for key in METHODS[name]]


def _rolls(scene: Scene) -> bool:
    return any(surface.rolling_friction > 0 for surface in scene.surfaces)


def _hexatic(scene: Scene) -> bool:
    return any(quantity.name.startswith("hexatic") for quantity in MEASURES["packing"].quantities(scene))


def _compares_angles(study: Study) -> bool:
    """True if the study compares hoppers of several angles, a flat one among them; reports then show laws of the
    angle."""
    hoppers = [point.scene.container for point in study.points if ANGLE in point.at]
    angles = {hopper.angle for hopper in hoppers if isinstance(hopper, WedgeHopper)}
    return len(angles) > 1 and any(math.isclose(angle, math.pi / 2) for angle in angles)
