"""The same pages as a folder of files, for `labbook site`.

A page needs only files beside it. Parts that need a server are left out: filtered lists of runs, comparisons, the
embedded viewer.
"""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from labbook.commands import command
from labbook.export.entities import ViewerMissing
from labbook.export.frames import NotRecorded
from labbook.lab import LabError, LabFolder, Unreadable
from labbook.lab.runs import picture_content
from labbook.study import StudyError
from labbook_web import viewer
from labbook_web.app import asset, assets
from labbook_web.page import FileLinks, Page
from labbook_web.pages import study as study_module
from labbook_web.pages.explore import explorable, explore_page
from labbook_web.pages.lab import card, lab_page, outcomes
from labbook_web.pages.point import point_page
from labbook_web.pages.run import run_page, sketch
from labbook_web.pages.study import study_page
from labbook_web.render import fragment, html
from labbook_web.store import LabStore, NotFound, StudyContents

MARK = "labbook-site.txt"
"""File that marks a folder as a site, which may be overwritten."""
FILES = ("svg", "pdf")
"""Files of each figure."""
_RUN_LIMIT = 5000
"""Largest number of runs of a site."""


class CannotWrite(Exception):
    """Error that keeps the site from being written; the message has the remedy."""


def write(
    out: Path,
    lab: Path,
    studies: Sequence[Path],
    *,
    recordings: bool = False,
    films: bool = False,
    notes: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> Path:
    """Write the pages of studies.

    Args:
        out: Folder to write: new, empty, or a site written before.
        lab: Folder of the lab.
        studies: Study files.
        recordings: Include recordings of runs.
        films: Make films of all recorded runs; films of the lab are included in any case.
        notes: Publish notes and tags of the studies and their runs.
        say: Called with the progress.

    Returns:
        Path of the first page.

    Raises:
        CannotWrite: A folder with other files, too many runs, or a study, run or viewer that cannot be read.
    """
    if out.exists() and (not out.is_dir() or (any(out.iterdir()) and not (out / MARK).is_file())):
        raise CannotWrite(f"{out} exists and is not a site of labbook: give a new or empty folder")
    store = LabStore(lab, studies, extra_only=True, with_notes=notes)
    listings = store.listings()
    if problems := [listing.problem for listing in listings if listing.problem]:
        raise CannotWrite(problems[0])
    try:
        writer = _Writer(out, store, [listing.name for listing in listings], recordings, films, say)
        writer.write()
    except (StudyError, LabError, NotFound, Unreadable) as error:
        raise CannotWrite(str(error)) from error
    return out / "index.html"


def has_notes(lab: Path) -> bool:
    """True if a lab has notes or tags, which a site may publish."""
    return any(LabFolder(lab).notes.rglob("*.md"))


class _Writer:
    def __init__(
        self,
        out: Path,
        store: LabStore,
        names: Sequence[str],
        recordings: bool,
        films: bool,
        say: Callable[[str], None],
    ):
        self._out, self._store, self._names, self._recordings, self._say = out, store, names, recordings, say
        self._films = films
        self._contents = {name: store.contents(name, store.backend_of(name, None)) for name in names}
        points = [result for contents in self._contents.values() for result in contents.results.points]
        self._runs = tuple(dict.fromkeys(run.run_key for result in points for run in result.runs))
        if len(self._runs) > _RUN_LIMIT:
            raise CannotWrite(f"{len(self._runs)} runs are too many for a site; the limit is {_RUN_LIMIT}")
        paths = [
            f"study/{name}/point/{result.point.index + 1}"
            for name, contents in self._contents.items()
            for result in contents.results.points
        ]
        paths += [f"study/{name}/explore" for name, contents in self._contents.items() if explorable(contents.study)]
        self._have = frozenset(
            ["index", *(f"study/{name}" for name in names), *paths, *(f"run/{key[:16]}" for key in self._runs)]
        )

    def write(self) -> None:
        """Write all pages and their files."""
        if (self._out / MARK).is_file():
            shutil.rmtree(self._out)
        self._out.mkdir(parents=True, exist_ok=True)
        (self._out / MARK).write_text("Written by labbook site, which may write this folder again.\n")
        for name in assets():
            if "htmx" not in name:
                self._file(f"static/{name}", asset(name) or b"")
        links = self._links("index")
        contexts = {one.name: card(self._store, one) for one in self._store.listings()}
        for tile in (tile for context in contexts.values() for tile in context.get("beds", ()) if tile.recorded):
            self._file(f"run/{tile.run[:16]}/loop.webp", viewer.loop(self._store.lab.run(tile.run)).read_bytes())
        cards = {name: _raw(fragment("card.html.j2", links, **context)) for name, context in contexts.items()}
        counts: dict[str, int] = {}
        for entry in self._contents.values():
            for outcome, number in outcomes(entry.results).items():
                counts[outcome] = counts.get(outcome, 0) + number
        packing_keys = {
            run.packing_key
            for contents in self._contents.values()
            for result in contents.results.points
            for run in result.runs
        }
        page = lab_page(self._store, {}, cards=max(1, len(self._names)))
        first_page = replace(
            page, title="Studies", data=lambda: {**page.data(), "runs": counts, "packings": len(packing_keys)}
        )
        self._page(first_page, cards=cards, counts=counts, packings=len(packing_keys), left=0)
        for name, entry in self._contents.items():
            self._say(f"{name}: {len(entry.results.points)} points")
            self._study(name)
            if explorable(entry.study):
                self._page(explore_page(self._store, name, {}))
            for result in entry.results.points:
                self._page(point_page(self._store, name, result.point.index + 1, {}))
        for position, key in enumerate(self._runs, 1):
            if position % 100 == 0:
                self._say(f"{position} of {len(self._runs)} runs")
            self._run(key)

    def _study(self, name: str) -> None:
        contents, page = self._contents[name], study_page(self._store, name, {})
        links, figures = self._links(page.path), {}
        for address in (*page.context["printed"], *page.context["figures"]):
            make = partial(self._figure, contents, address, f"{page.path}/figure/{address}")
            context = {**study_module.figure(contents, address, make), "kinds": FILES}
            if context["table"] and (table := study_module.numbers(contents, address)) is not None:
                self._file(f"{page.path}/figure/{address}.csv", table.to_csv(index=False).encode())
            figures[address] = _raw(fragment("figure.html.j2", links, contents=contents, **context))
        self._file(f"{page.path}/{name}.yaml", contents.text.encode())
        self._page(page, drawn=figures, kinds=FILES, command=command("run", f"{name}.yaml"))

    def _figure(self, contents: StudyContents, address: str, stem: str) -> None:
        files = study_module.encoded(study_module.draw(contents, address)[1], *FILES)
        for kind, content in zip(FILES, files, strict=True):
            self._file(f"{stem}.{kind}", content)

    def _run(self, key: str) -> None:
        page = run_page(self._store, key, {})
        picture = picture_content(self._store.lab.run(key))
        recording = ""
        self._file(f"{page.path}/picture.png", picture or sketch(self._store, key).encode())
        if self._recordings and page.context.get("recorded"):
            try:
                source = viewer.recording([self._store.lab.run(key)])
                recording = f"{page.path}/recording.rrd"
                self._file(recording, source.read_bytes())
            except (NotRecorded, ViewerMissing) as error:
                raise CannotWrite(str(error)) from error
        film = ""
        if page.context.get("recorded"):
            folder = self._store.lab.run(key)
            path = viewer.film(folder) if self._films else viewer.stored_film(folder)
            if path is not None:
                film = f"{page.path}/film.webp"
                self._file(film, path.read_bytes())
        self._page(page, recording=recording, film=film)

    def _page(self, page: Page, **context: Any) -> None:
        links = self._links(page.path or "index")
        output = replace(page, context={**page.context, **context}, query={})
        name = page.path or "index"
        self._file(f"{name}.html", html(output, links).encode())
        self._file(f"{name}.json", page.json().encode())
        self._file(f"{name}.csv", page.csv().encode())

    def _links(self, path: str) -> FileLinks:
        return FileLinks(path, self._have)

    def _file(self, name: str, content: bytes) -> None:
        path = self._out / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        except OSError as error:
            error.filename = error.filename or str(path)  # a full disk does not say
            raise


def _raw(text: str):
    from markupsafe import Markup

    return Markup(text)
