"""The list of runs: filtered, sorted and cut into pages by the index."""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pandas as pd

from labbook.lab import notes
from labbook.lab.catalogue import FLOW_RATE, RUN_COLUMNS, SUSPECT, Catalogue, Listing
from labbook_web.page import Page, records
from labbook_web.pages.changes import moment
from labbook_web.store import LabStore, NotFound

PAGE_SIZE = 100
"""Runs on a page."""
SORTED_BY = (*(name for name in RUN_COLUMNS if name != "problem"), FLOW_RATE)
PREFIX = "at:"
"""Prefix of the columns of swept keys."""
FILTERS = ("study", "backend", "outcome", "packing", "tag", "q", "since")
_UNITS = {FLOW_RATE: "kg/s", "duration": "s", "wall_time": "s", "device_time": "s", "rate": "1/s"}
_NUMBER = re.compile(r"(?P<name>.+?) (?P<value>-?[\d.]+(?:e[-+]?\d+)?)(?: (?P<unit>\D.*))?")
_TAG_LIMIT = 500


def runs_page(store: LabStore, query: Mapping[str, str]) -> Page:
    """List runs. Those of one study have a column for each swept key, `at:` and its name.

    Args:
        store: Studies and runs.
        query: Filters `study`, `backend`, `outcome`, `packing`, `tag`, `q` (text) and `since` (a date); `sort`: name of
            a column, after a minus sign in descending order; `page`: number of the page, from 1.

    Raises:
        NotFound: A page beyond the last one, a column that these runs do not have, or more runs with the tag than can
            be listed.
        NoMoment: A malformed date.
    """
    filters = {name: query[name] for name in FILTERS if query.get(name)}
    sort, number = query.get("sort", "-finished"), int(query.get("page", "1"))
    listing = Listing(
        study=filters.get("study"),
        backend=filters.get("backend"),
        outcome=filters.get("outcome"),
        packing=filters.get("packing"),
        text=filters.get("q"),
        keys=_tagged(store, filters["tag"]) if "tag" in filters else None,
        since=moment(filters["since"]) if "since" in filters else None,
        sort=sort.removeprefix("-"),
        descending=sort.startswith("-"),
        offset=PAGE_SIZE * (number - 1),
        limit=PAGE_SIZE,
    )
    catalogue = store.catalogue
    frame, total = _listed(catalogue, listing)
    pages = max(1, -(-total // PAGE_SIZE))
    if not 1 <= number <= pages:
        raise NotFound(f"there is no page {number}; the last one is {pages}")
    studies = store.counts()
    tags = notes.tagged(store.lab, "run")
    return Page(
        "runs.html.j2",
        "runs",
        "Runs",
        lambda: {"total": total, "page": number, "pages": pages, "runs": frame.to_dict("records")},
        lambda: _listed(catalogue, replace(listing, offset=0, limit=None))[0],
        {
            "rows": records(frame),
            "keys": [name for name in frame if name.startswith(PREFIX)],
            "news": _news(catalogue, listing) if listing.since is not None else {},
            "total": total,
            "number": number,
            "pages": pages,
            "asked": filters,
            "sort": sort,
            "tags": tags,
            "studies": sorted({count.study for count in studies if count.study}),
            "backends": sorted({count.backend for count in studies if count.backend}),
            "outcomes": sorted({count.outcome for count in studies}) + [SUSPECT] * bool(catalogue.suspect_count()),
            "known_tags": sorted({tag for each in tags.values() for tag in each}),
        },
        query={**filters, **_sort_and_page(query)},
    )


def sortable(column: str) -> bool:
    """True if runs can be sorted by a column: one of the index, the flow rate, or that of a swept key."""
    return column in (*RUN_COLUMNS, *SORTED_BY) or column.startswith(PREFIX)


def _listed(catalogue: Catalogue, listing: Listing) -> tuple[pd.DataFrame, int]:
    """Runs as the index lists them, those of one study with a column for each swept key. Keys sort as numbers."""
    if not listing.sort.startswith(PREFIX):
        frame, total = catalogue.listed(listing)
        return _with_keys(frame, listing), total
    rows, total = catalogue.listed(replace(listing, sort="finished", descending=True, offset=0, limit=None))
    rows = _with_keys(rows, listing)
    if listing.sort not in rows:
        raise NotFound(f"these runs have no column {listing.sort[:60]}; choose one study that sweeps this key")
    rows = rows.sort_values(listing.sort, ascending=not listing.descending, kind="stable", na_position="last")
    end = None if listing.limit is None else listing.offset + listing.limit
    return rows.iloc[listing.offset : end], total


def _with_keys(frame: pd.DataFrame, listing: Listing) -> pd.DataFrame:
    columns: dict[str, list[Any]] = {}
    if listing.study is not None:
        settings = [dict(filter(None, map(_setting, str(label).split(", ")))) for label in frame["label"]]
        names = dict.fromkeys(name for setting in settings for name in setting)
        columns = {name: [setting.get(name) for setting in settings] for name in names}
    for name, values in columns.items():
        words = any(isinstance(value, str) for value in values)
        frame[name] = [None if value is None else str(value) for value in values] if words else values
    frame.attrs["units"] = _UNITS
    return frame


def _setting(text: str) -> tuple[str, float | str] | None:
    """Name with unit, and value, of a part of a label such as `orifice 24 mm`; None of text without a value."""
    if number := _NUMBER.fullmatch(text):
        return f"{PREFIX}{number['name']}" + (f" [{number['unit']}]" if number["unit"] else ""), float(number["value"])
    name, _, word = text.rpartition(" ")
    return (f"{PREFIX}{name}", word) if name else None


def _news(catalogue: Catalogue, listing: Listing) -> dict[str, int]:
    """Number of runs since the date of a listing, by study."""
    frame, _ = catalogue.listed(replace(listing, sort="finished", descending=True, offset=0, limit=None))
    return {str(name): int(count) for name, count in frame["study"].value_counts().items() if name}


def _sort_and_page(query: Mapping[str, str]) -> dict[str, Any]:
    return {name: query[name] for name in ("sort", "page") if name in query}


def _tagged(store: LabStore, tag: str) -> tuple[str, ...]:
    keys = [key for key, tags in notes.tagged(store.lab, "run").items() if tag in tags]
    if len(keys) > _TAG_LIMIT:
        raise NotFound(f"{len(keys)} runs have the tag {tag}, more than {_TAG_LIMIT} can be listed")
    return tuple(keys)
