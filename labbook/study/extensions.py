"""The extensions that a study uses: which packages are behind its laws, walls, measures and fits."""

from collections.abc import Iterator

from labbook.backend import extension_of
from labbook.campaign import STRATEGIES
from labbook.filling.placing import STARTS
from labbook.fit import LAWS
from labbook.measure import MEASURES
from labbook.plugins import Extension
from labbook.scene import CONTACT_LAWS
from labbook.scene.walls import WALL_SHAPES
from labbook.study.load import Study
from labbook.study.paper import PAPERS
from labbook.study.point import Point


def used_by_runs(point: Point, *backends: str) -> tuple[Extension, ...]:
    """The extensions that runs of a point use: contact laws, walls, the start, and the backends that are named."""
    entries = (*_of_point(point), *map(extension_of, backends))
    return tuple(dict.fromkeys(entry for entry in entries if entry is not None))


def used_by_analysis(study: Study) -> tuple[Extension, ...]:
    """The extensions that the analysis of a study uses: measures, flow laws, its strategy, and papers by their fits
    and quantities."""
    reference = study.reference
    quantities = () if reference is None else (*reference.entries, *reference.statements)
    words = {*study.fit, *(quantity.quantity.partition(".")[0] for quantity in quantities)}
    measures = (one for name, one in MEASURES.extensions.items() if name in study.measure)
    laws = (one for name, one in LAWS.extensions.items() if name in words)
    papers = (one for name, one in PAPERS.extensions.items() if words.intersection(PAPERS[name].words))
    adapt = () if study.adapt is None else (STRATEGIES.extensions.get(study.adapt.name),)
    return (*measures, *laws, *papers, *(one for one in adapt if one is not None))


def _of_point(point: Point) -> Iterator[Extension | None]:
    for law in (point.scene.contact, point.fill.contact):
        if law is not None:
            yield CONTACT_LAWS.extensions.get(law.law)
    if WALL_SHAPES.extensions:
        for wall in point.scene.container.walls():
            yield WALL_SHAPES.extensions.get(wall.shape.kind)
    yield STARTS.extensions.get(point.fill.kind)
