"""The first page: the studies of a lab as cards, what is running now, and how runs ended."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from labbook.api import Results
from labbook.commands import command
from labbook.lab import LabError
from labbook.lab.catalogue import SUSPECT
from labbook.lab.journal import unfinished
from labbook.plan.demand import fewest_runs
from labbook.report.result_box import concerns, headline
from labbook.run.live import Running
from labbook.scene.quantities import duration
from labbook.study import StudyError
from labbook_web.page import Page
from labbook_web.pages.sheet import extremes
from labbook_web.pages.tiles import value_range
from labbook_web.shelf import Found, NotThere, Shelf, StudyListing

CARDS = 24
"""Studies on a page."""
_BEDS = 6
"""Beds on a card."""


def lab_page(shelf: Shelf, query: Mapping[str, str], cards: int | None = None) -> Page:
    """The studies whose name, file or tags have the text `q` in them, page by page.

    The first page is number 1. cards: how many are on a page; None: CARDS.
    """
    text, number = query.get("q", "").strip(), int(query.get("page", "1"))
    every = shelf.listed()
    found = [one for one in every if _has(shelf, one, text)]
    most = cards or CARDS
    pages = max(1, -(-len(found) // most))
    if not 1 <= number <= pages:
        raise NotThere(f"there is no page {number}; the last one is {pages}")
    shown = found[most * (number - 1) : most * number]
    counts, packings = shelf.catalogue.counts(), shelf.catalogue.packing_count()
    if suspect := shelf.catalogue.suspect_count():
        counts[SUSPECT] = suspect
    studies = [_told(one) for one in found]
    return Page(
        "lab.html.j2",
        "",
        shelf.lab.folder.resolve().name,
        lambda: {"studies": studies, "runs": counts, "packings": packings,
                 "running": [one.plain() for one in shelf.running()]},
        lambda: pd.DataFrame(studies),
        {"listed": shown, "text": text, "number": number, "pages": pages, "found": len(found), "every": len(every),
         "counts": counts, "packings": packings, "running": bool(shelf.running()), "left": len(unfinished(shelf.lab)),
         "command": command("run", "first.yaml", lab=shelf.lab.folder)},
        query={"q": text} if text else {},
    )  # fmt: skip


def card(shelf: Shelf, listed: StudyListing) -> dict[str, Any]:
    """What the card of one study shows: contact sheet, progress, outcomes and result; or why it cannot be read."""
    shown: dict[str, Any] = {"one": listed, "problem": listed.problem, "found": None}
    shown["command"] = command("web", f"{listed.name}.yaml", lab=shelf.lab.folder)
    if listed.path is None or listed.problem:
        return shown
    going = shelf.running()
    try:
        found = shelf.found(listed.name, shelf.backend_of(listed.name, None))
    except (StudyError, LabError, NotThere) as problem:
        return {**shown, "problem": str(problem)}
    results = found.results
    return {
        **shown,
        "found": found,
        "beds": found.once("beds", lambda: extremes(results, _BEDS)),
        "range": found.once("range", lambda: value_range(results)),
        "headline": headline(results) if any(one.fits for one in results.series) else "",
        "concerns": found.once("concerns", lambda: concerns(results)) if results.points else [],
        "progress": progress(found, going),
        "outcomes": outcomes(results),
    }


def progress(found: Found, running: Sequence[Running]) -> dict[str, Any]:
    """How many runs of a study are there, of how many; and the processes that run it now on this backend."""
    results, study = found.results, found.study
    done = sum(len(one.runs) for one in results.points)
    asked = sum(max(one.requested, len(one.runs)) for one in results.points) + fewest_runs(study) * len(results.missing)
    going = [
        {"rate": one.rate, "left": _left(one), "jobs": one.going, "more": one.jobs - len(one.going)}
        for one in running
        if one.study == study.name and one.backend == found.backend
    ]
    return {"done": done, "asked": asked, "part": done / asked if asked else 0.0, "running": going}


def _left(one: Running) -> str:
    """The time that is left, in words; empty while it is not known."""
    if one.seconds_left is None:
        return ""
    return f"{'at least' if one.open_ended else 'about'} {duration(one.seconds_left)}"


def outcomes(results: Results) -> dict[str, int]:
    """How many runs ended in which way, and how many of them are suspect."""
    found: dict[str, int] = {}
    for one in results.points:
        for name, count in one.outcomes.items():
            found[name] = found.get(name, 0) + count
        if one.suspect:
            found[SUSPECT] = found.get(SUSPECT, 0) + len(one.suspect)
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _has(shelf: Shelf, one: StudyListing, text: str) -> bool:
    if not text:
        return True
    return text.lower() in " ".join((one.name, shelf.text(one), *one.note.tags)).lower()


def _told(one: StudyListing) -> dict[str, Any]:
    ended: dict[str, int] = {}
    for count in one.counts:
        ended[count.outcome] = ended.get(count.outcome, 0) + count.runs
    return {
        "study": one.name,
        "runs": one.runs,
        **{f"runs_{name.replace('-', '_')}": count for name, count in sorted(ended.items())},
        "backends": ", ".join(one.backends),
        "latest": one.latest,
        "tags": ", ".join(one.note.tags),
        "problem": one.problem,
    }
