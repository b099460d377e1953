"""The first page: the studies of a lab as cards, what is running now, and how runs ended."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from struct import unpack
from typing import Any

import pandas as pd

from labbook.api import Results
from labbook.commands import command
from labbook.lab import LabError
from labbook.lab.catalogue import SUSPECT
from labbook.lab.journal import unfinished
from labbook.lab.runs import picture_content
from labbook.plan.demand import fewest_runs
from labbook.report.result_box import concerns, headline
from labbook.run.live import Running
from labbook.scene import drawing
from labbook.scene.quantities import duration
from labbook.study import StudyError
from labbook_web.page import Page
from labbook_web.pages.sheet import Tile, extremes
from labbook_web.pages.tiles import value_range
from labbook_web.store import LabStore, NotFound, StudyContents, StudyListing

CARDS = 24
"""Studies on a page."""
_BEDS = 6
"""Beds on a card."""


def lab_page(store: LabStore, query: Mapping[str, str], cards: int | None = None) -> Page:
    """List the studies of a lab.

    Args:
        store: Studies and their results.
        query: `q`: text in the name, the file or the tags of the studies; `page`: number of the page, from 1.
        cards: Studies on a page; None for CARDS.

    Raises:
        NotFound: A page beyond the last one.
        LabError: An index that cannot be read.
    """
    text, number = query.get("q", "").strip(), int(query.get("page", "1"))
    listings = store.listings()
    matches = [listing for listing in listings if _has(store, listing, text)]
    size = cards or CARDS
    pages = max(1, -(-len(matches) // size))
    if not 1 <= number <= pages:
        raise NotFound(f"there is no page {number}; the last one is {pages}")
    section = matches[size * (number - 1) : size * number]
    counts, packings = store.catalogue.counts(), store.catalogue.packing_count()
    if suspect := store.catalogue.suspect_count():
        counts[SUSPECT] = suspect
    studies = [_row(listing) for listing in matches]
    return Page(
        "lab.html.j2",
        "",
        store.lab.folder.resolve().name,
        lambda: {"studies": studies, "runs": counts, "packings": packings,
                 "running": [process.plain() for process in store.running()]},
        lambda: pd.DataFrame(studies),
        {"listed": section, "text": text, "number": number, "pages": pages, "matches": len(matches),
         "every": len(listings), "counts": counts, "packings": packings, "running": bool(store.running()),
         "left": len(unfinished(store.lab)), "command": command("run", "first.yaml", lab=store.lab.folder)},
        query={"q": text} if text else {},
    )  # fmt: skip


def card(store: LabStore, listing: StudyListing) -> dict[str, Any]:
    """Context of the card of a study: beds, progress, outcomes and result; or the reason why it cannot be read."""
    context: dict[str, Any] = {"listing": listing, "problem": listing.problem, "contents": None, "sketch": ""}
    context["command"] = command("web", f"{listing.name}.yaml", lab=store.lab.folder)
    if listing.path is None or listing.problem:
        return context
    processes = store.running()
    try:
        contents = store.contents(listing.name, store.backend_of(listing.name, None))
    except (StudyError, LabError, NotFound) as problem:
        return {**context, "problem": str(problem)}
    results = contents.results
    beds = contents.cached("beds", lambda: extremes(results, _BEDS))
    return {
        **context,
        "contents": contents,
        "beds": beds,
        "columns": columns_of(len(beds), _shape(store, beds)) if beds else 0,
        "sketch": "" if beds else contents.cached("sketch", lambda: _sketch(contents)),
        "range": contents.cached("range", lambda: value_range(results)),
        "headline": headline(results) if any(series.fits for series in results.series) else "",
        "concerns": contents.cached("concerns", lambda: concerns(results)) if results.points else [],
        "progress": progress(contents, processes),
        "outcomes": outcomes(results),
    }


def columns_of(beds: int, shape: float) -> int:
    """Number of columns of a card in which beds are largest.

    Args:
        beds: Number of beds, at least 1.
        shape: Width of a bed over its height.
    """

    def height(columns: int) -> float:
        rows = -(-beds // columns)
        return min(_BOX[0] / columns / shape, _BOX[1] / rows - _NUMBER)

    return max(range(1, beds + 1), key=height)


_BOX, _NUMBER = (380.0, 236.0), 20.0
"""Width and height of the beds of a card, and height of the number below a bed [pixels]."""


def _shape(store: LabStore, beds: Sequence[Tile]) -> float:
    """Width over height of the picture of the first bed that has one; 1 without."""
    for tile in beds:
        content = picture_content(store.lab.run(tile.run)) if tile.run else None
        if content is not None:
            width, height = unpack(">II", content[16:24])  # of the header of a PNG
            return width / height
    return 1.0


def _sketch(contents: StudyContents) -> str:
    """Address with the drawing of the first point, for a study without runs; empty where nothing can be drawn."""
    scene = contents.study.points[0].scene
    sketch = drawing.svg(scene.grains, scene.container, sized=False)
    return f"data:image/svg+xml;base64,{b64encode(sketch.encode()).decode('ascii')}" if sketch else ""


def progress(contents: StudyContents, running: Sequence[Running]) -> dict[str, Any]:
    """Number of finished and of requested runs of a study, and the processes that run it on this backend."""
    results, study = contents.results, contents.study
    done = sum(len(result.runs) for result in results.points)
    total = sum(max(one.requested, len(one.runs)) for one in results.points) + fewest_runs(study) * len(results.missing)
    processes = [
        {"rate": process.rate, "left": _left(process), "jobs": process.going, "more": process.jobs - len(process.going)}
        for process in running
        if process.study == study.name and process.backend == contents.backend
    ]
    return {"done": done, "asked": total, "part": done / total if total else 0.0, "running": processes}


def _left(process: Running) -> str:
    """Remaining time in words; empty while there is no estimate."""
    if process.seconds_left is None:
        return ""
    return f"{'at least' if process.open_ended else 'about'} {duration(process.seconds_left)}"


def outcomes(results: Results) -> dict[str, int]:
    """Number of runs by outcome, and of suspect runs; the most frequent outcome first."""
    counts: dict[str, int] = {}
    for result in results.points:
        for name, count in result.outcomes.items():
            counts[name] = counts.get(name, 0) + count
        if result.suspect:
            counts[SUSPECT] = counts.get(SUSPECT, 0) + len(result.suspect)
    return dict(sorted(counts.items(), key=lambda item: -item[1]))


def _has(store: LabStore, listing: StudyListing, text: str) -> bool:
    if not text:
        return True
    return text.lower() in " ".join((listing.name, store.text(listing), *listing.note.tags)).lower()


def _row(listing: StudyListing) -> dict[str, Any]:
    runs_by_outcome: dict[str, int] = {}
    for count in listing.counts:
        runs_by_outcome[count.outcome] = runs_by_outcome.get(count.outcome, 0) + count.runs
    return {
        "study": listing.name,
        "runs": listing.runs,
        **{f"runs_{name.replace('-', '_')}": count for name, count in sorted(runs_by_outcome.items())},
        "backends": ", ".join(listing.backends),
        "latest": listing.latest,
        "tags": ", ".join(listing.note.tags),
        "problem": listing.problem,
    }
