"""The list of runs: filtered, sorted and cut into pages by the index."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from labbook.lab import notes
from labbook.lab.catalogue import RUN_COLUMNS, SUSPECT, Listing
from labbook_web.page import Page, records
from labbook_web.shelf import NotThere, Shelf

LONG = 100
"""Runs on a page."""
SORTED_BY = tuple(name for name in RUN_COLUMNS if name != "problem")
FILTERS = ("study", "backend", "outcome", "packing", "tag", "q")
_MOST_TAGGED = 500


def runs_page(shelf: Shelf, query: Mapping[str, str]) -> Page:
    """The runs that the filters leave (`study`, `backend`, `outcome`, `packing`, `tag`, and `q`: text), in the order of
    the column `sort`, from the greatest if it begins with a minus sign. `page`: from 1. Raises NotThere."""
    asked = {name: query[name] for name in FILTERS if query.get(name)}
    sort, number = query.get("sort", "-finished"), int(query.get("page", "1"))
    wanted = Listing(
        study=asked.get("study"),
        backend=asked.get("backend"),
        outcome=asked.get("outcome"),
        packing=asked.get("packing"),
        text=asked.get("q"),
        keys=_tagged(shelf, asked["tag"]) if "tag" in asked else None,
        sort=sort.removeprefix("-"),
        descending=sort.startswith("-"),
        offset=LONG * (number - 1),
        limit=LONG,
    )
    catalogue = shelf.catalogue
    found, total = catalogue.listed(wanted)
    pages = max(1, -(-total // LONG))
    if not 1 <= number <= pages:
        raise NotThere(f"there is no page {number}; the last one is {pages}")
    studies = shelf.counts()
    tags = notes.tagged(shelf.lab, "run")
    return Page(
        "runs.html.j2",
        "runs",
        "Runs",
        lambda: {"total": total, "page": number, "pages": pages, "runs": found.to_dict("records")},
        lambda: catalogue.listed(replace(wanted, offset=0, limit=None))[0],
        {
            "rows": records(found),
            "total": total,
            "number": number,
            "pages": pages,
            "asked": asked,
            "sort": sort,
            "tags": tags,
            "studies": sorted({one.study for one in studies if one.study}),
            "backends": sorted({one.backend for one in studies if one.backend}),
            "outcomes": sorted({one.outcome for one in studies}) + [SUSPECT] * bool(catalogue.suspect_count()),
            "known_tags": sorted({tag for each in tags.values() for tag in each}),
        },
        query={**asked, **_stated(query)},
    )


def _stated(query: Mapping[str, str]) -> dict[str, Any]:
    return {name: query[name] for name in ("sort", "page") if name in query}


def _tagged(shelf: Shelf, tag: str) -> tuple[str, ...]:
    keys = [key for key, tags in notes.tagged(shelf.lab, "run").items() if tag in tags]
    if len(keys) > _MOST_TAGGED:
        raise NotThere(f"{len(keys)} runs have the tag {tag}, more than {_MOST_TAGGED} can be listed")
    return tuple(keys)
