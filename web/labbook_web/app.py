"""The app: routes, and the response to each request."""

import hashlib
import json
import logging
import os
import string
from collections.abc import Callable, Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, quote

import anyio.to_thread
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response
from starlette.routing import Route

from labbook.backend import BackendMissing
from labbook.export.entities import ViewerMissing
from labbook.export.frames import NotRecorded
from labbook.export.recording import SIDE_BY_SIDE, path_of, titled
from labbook.lab import LabError, RunRecord, Unreadable, notes
from labbook.lab.evaluations import NotEvaluated
from labbook.lab.notes import Note
from labbook.lab.runs import picture_content
from labbook.study import StudyError
from labbook_web import viewer
from labbook_web.guard import BODY_LIMIT, Guard
from labbook_web.page import Links, Page
from labbook_web.pages import lab, run, runs, study
from labbook_web.pages.changes import NoMoment
from labbook_web.pages.compare import Malformed, compare_page
from labbook_web.pages.explore import explore_page
from labbook_web.pages.lab import card, lab_page
from labbook_web.pages.point import point_page
from labbook_web.pages.run import file_of, key_of, run_page
from labbook_web.pages.runs import runs_page
from labbook_web.pages.study import study_page
from labbook_web.render import fragment, html
from labbook_web.store import LabStore, NotFound

LINKS = Links()
STATIC = files("labbook_web") / "static"
_KINDS = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".txt": "text/plain"}
_FIGURE_TYPES = {"svg": "image/svg+xml", "png": "image/png", "pdf": "application/pdf"}
_PLAIN = frozenset(string.ascii_letters + string.digits + "-_. ")
_LASTING = {"cache-control": "private, max-age=31536000, immutable"}
_log = logging.getLogger("labbook.web")
_ALLOWED = {
    "lab": {"q", "page", "token"},
    "study": {"backend", "as", "x", "y", "scale", "fits", "brush", "sort", "find", "since"},
    "point": {"backend"},
    "explore": {"backend", "view", "at", "want", "over", "x", "y"},
    "run": set[str](),
    "runs": {*runs.FILTERS, "sort", "page"},
    "compare": {"item"},
}
"""Query parameters of each page; each is given once."""


def application(store: LabStore, *, read_only: bool = False, hosts: frozenset[str] = frozenset(), token: str = ""):
    """Make the ASGI app of a lab.

    Args:
        store: Studies of the lab and their results.
        read_only: Refuse to write notes and tags.
        hosts: As `Guard` takes them.
        token: As `Guard` takes it.
    """
    app = App(store, read_only)
    return Guard(app.starlette, hosts, token)


class App:
    """Routes and handlers of the app for one store."""

    def __init__(self, store: LabStore, read_only: bool):
        self.store, self.read_only = store, read_only
        name = "/study/{name:str}"
        pages: list[tuple[str, Callable[[Request], Page]]] = [
            (name + "/point/{number:int}", self._point),
            (name + "/explore", self._explore),
            (name, self._study),
            ("/runs", self._runs),
            ("/run/{key:str}", self._run),
            ("/compare", self._compare),
            ("/index", self._lab),
        ]
        routes = [Route("/", self._page_handler(self._lab, ""))]
        for path, make in pages:
            routes += [Route(f"{path}.{ending}", self._page_handler(make, ending)) for ending in ("json", "csv")]
            routes += [Route(path, self._page_handler(make, ""))] if path != "/index" else []
        routes += [
            Route("/card/{name}", self._in_thread(self._card)),
            Route("/progress/{name}", self._in_thread(self._progress)),
            Route("/study/{name}/figure/{figure}", self._in_thread(self._figure)),
            Route("/study/{name}/{file}.yaml", self._in_thread(self._yaml)),
            Route("/study/{name}/compare/{pair}.rrd", self._in_thread(self._comparison_recording)),
            Route("/note/{kind}/{name}", self._write_note, methods=["POST"]),
            Route("/run/{key}/picture.png", self._in_thread(self._picture)),
            Route("/run/{key}/viewer", self._in_thread(self._viewer)),
            Route("/beside/{key}/viewer", self._in_thread(self._viewer)),
            Route("/beside/{key}/recording.rrd", self._in_thread(self._recording)),
            Route("/run/{key}/film.webp", self._in_thread(self._film)),
            Route("/run/{key}/loop.webp", self._in_thread(self._loop)),
            Route("/run/{key}/recording.rrd", self._in_thread(self._recording)),
            Route("/run/{key}/file/{file}", self._in_thread(self._file)),
            Route("/viewer/{version}/{file:path}", self._in_thread(self._viewer_file)),
            Route("/static/{file:path}", self._in_thread(self._static)),
            Route("/favicon.ico", self._in_thread(lambda request: RedirectResponse(LINKS.asset("icon.svg"), 301))),
        ]
        self.starlette = Starlette(
            routes=routes, exception_handlers={HTTPException: self._http_error, Exception: self._server_error}
        )

    # responses

    def _in_thread(self, make: Callable[[Request], Response]):
        async def answer(request: Request) -> Response:
            return await anyio.to_thread.run_sync(self._response, make, request)

        return answer

    def _page_handler(self, make: Callable[[Request], Page], ending: str):
        def respond(request: Request) -> Response:
            page = make(request)
            if ending == "json":
                return Response(page.json(), media_type="application/json")
            if ending == "csv":
                name = page.path.replace("/", "-") or "studies"
                return Response(page.csv(), media_type="text/csv; charset=utf-8", headers=saved_as(f"{name}.csv"))
            return HTMLResponse(html(page, LINKS, **self._shared_context()))

        return self._in_thread(respond)

    def _response(self, make: Callable[[Request], Response], request: Request) -> Response:
        """Make a response; errors of the lab become HTTP errors.

        Args:
            make: Handler, called in a worker thread.
            request: Request that it gets.

        Raises:
            HTTPException: 404 for missing things, 400 for malformed requests, 422 for invalid studies, 503 for a lab,
                run or backend that cannot be read.
        """
        try:
            return make(request)
        except HTTPException:
            raise
        except NotFound as error:
            raise HTTPException(404, str(error)) from error
        except (Malformed, NoMoment, StudyError) as error:
            raise HTTPException(422 if isinstance(error, StudyError) else 400, str(error)) from error
        except (LabError, Unreadable, BackendMissing, NotEvaluated) as error:
            raise HTTPException(503, str(error)) from error

    def _shared_context(self) -> dict[str, Any]:
        return {"read_only": self.read_only, "lab": self.store.lab.folder.resolve().name}

    async def _http_error(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        return await anyio.to_thread.run_sync(self._error_response, request, error.status_code, str(error.detail))

    async def _server_error(self, request: Request, error: Exception) -> Response:
        _log.error("%s could not be answered", request.url.path, exc_info=error)
        return await anyio.to_thread.run_sync(self._error_response, request, 500, "labbook has an internal error; "
                                              "the terminal in which labbook web runs shows it.")  # fmt: skip

    def _error_response(self, request: Request, status: int, why: str) -> Response:
        if request.url.path.endswith(".json"):
            return Response(json.dumps({"error": why}), status, media_type="application/json")
        if request.headers.get("hx-request"):
            return HTMLResponse(fragment("problem.html.j2", LINKS, why=why), status)
        page = Page("error.html.j2", "", f"{status}", dict, _no_frame, {"status": status, "why": why})
        return HTMLResponse(html(page, LINKS, **self._shared_context()), status)

    # pages

    def _lab(self, request: Request) -> Page:
        return lab_page(self.store, query_of(request, "lab"))

    def _study(self, request: Request) -> Page:
        return study_page(self.store, request.path_params["name"], query_of(request, "study"))

    def _explore(self, request: Request) -> Page:
        return explore_page(self.store, request.path_params["name"], query_of(request, "explore"))

    def _point(self, request: Request) -> Page:
        number = request.path_params["number"]
        return point_page(self.store, request.path_params["name"], number, query_of(request, "point"))

    def _run(self, request: Request) -> Page:
        return run_page(self.store, hex_of(request), query_of(request, "run"))

    def _runs(self, request: Request) -> Page:
        return runs_page(self.store, query_of(request, "runs"))

    def _compare(self, request: Request) -> Page:
        pairs = parse_qsl(request.url.query, keep_blank_values=True)
        if extras := {name for name, _ in pairs} - _ALLOWED["compare"]:
            raise HTTPException(400, f"{sorted(extras)[0][:60]} is not known here; use item=run:KEY and the like")
        return compare_page(self.store, [value for _, value in pairs if value])

    # parts of pages, and files

    def _card(self, request: Request) -> Response:
        name = request.path_params["name"]
        for listing in self.store.listings():
            if listing.name == name:
                return HTMLResponse(fragment("card.html.j2", LINKS, **card(self.store, listing)))
        raise NotFound(f"there is no study {name}")

    def _progress(self, request: Request) -> Response:
        name = request.path_params["name"]
        processes = self.store.running()  # before the results: whoever hears of nobody has heard of all runs
        contents = self.store.contents(name, self.store.backend_of(name, request.query_params.get("backend")))
        context = {"progress": lab.progress(contents, processes), "contents": contents}
        return HTMLResponse(fragment("progress.html.j2", LINKS, **context))

    def _figure(self, request: Request) -> Response:
        name, figure = request.path_params["name"], request.path_params["figure"]
        contents = self.store.contents(name, self.store.backend_of(name, request.query_params.get("backend")))
        address, _, kind = figure.rpartition(".")
        lasting = _LASTING if "state" in request.query_params else {}
        if kind == "csv":
            table = study.numbers(contents, address)
            if table is None:
                raise NotFound(f"the figure {address[:80]} of {name} has no table of its numbers")
            headers = saved_as(f"{name}-{address}.csv")
            return Response(table.to_csv(index=False), media_type="text/csv; charset=utf-8", headers=headers)
        if kind in _FIGURE_TYPES:
            headers = {**lasting, **({} if kind == "svg" else saved_as(f"{name}-{address}.{kind}"))}
            try:
                content = study.picture(self.store, contents, address, kind)
            except study.CANNOT_DRAW as error:
                raise NotFound(study.why_not(error, contents)) from error
            return Response(content, media_type=_FIGURE_TYPES[kind], headers=headers)
        context = study.figure(contents, figure, lambda: study.picture(self.store, contents, figure))
        return HTMLResponse(fragment("figure.html.j2", LINKS, contents=contents, **context))

    def _yaml(self, request: Request) -> Response:
        text = self.store.study(request.path_params["name"])[1]
        return Response(
            text, media_type="text/yaml; charset=utf-8", headers=saved_as(f"{request.path_params['name']}.yaml")
        )

    def _comparison_recording(self, request: Request) -> Response:
        name, pair = request.path_params["name"], request.path_params["pair"]
        contents = self.store.contents(name, self.store.backend_of(name, None))
        for comparison in contents.comparisons:
            if comparison.name == pair and comparison.recording is not None:
                return FileResponse(
                    comparison.recording, media_type="application/octet-stream", headers=saved_as(f"{name}-{pair}.rrd")
                )
        raise NotFound(f"{name} has no recording of {pair[:80]}: labbook compare --record makes one")

    def _picture(self, request: Request) -> Response:
        key = key_of(self.store, hex_of(request))
        picture = picture_content(self.store.lab.run(key))
        if picture is not None:
            return Response(picture, media_type="image/png", headers={"cache-control": "private, max-age=60"})
        sketch = run.sketch(self.store, key)
        return Response(sketch, media_type="image/svg+xml", headers={"cache-control": "private, max-age=60"})

    def _viewer(self, request: Request) -> Response:
        """Viewer with the recording of a run, or of several side by side."""
        keys = self._keys(request)
        folders = [self.store.lab.run(key) for key in keys]
        try:
            viewer.viewer_files()
            viewer.recording(folders)
            opens = viewer.opening(folders)
        except (viewer.NoViewer, ViewerMissing, NotRecorded, OSError) as error:
            return HTMLResponse(fragment("problem.html.j2", LINKS, why=str(error)))
        short = "-".join(key[:16] for key in keys)
        path = f"beside/{short}/recording.rrd" if len(keys) > 1 else f"run/{short}/recording.rrd"
        context = {
            "name": " beside ".join(titled(RunRecord.read(folder)) for folder in folders),
            "version": viewer.version(),
            "source": f"{request.url.scheme}://{request.headers['host']}/{path}",
            "path": path,
            "opens": opens,
        }
        return HTMLResponse(fragment("viewer.html.j2", LINKS, **context))

    def _keys(self, request: Request) -> list[str]:
        """Keys of the runs in an address: their first digits, joined by hyphens."""
        keys = request.path_params["key"].split("-")
        if len(keys) > SIDE_BY_SIDE:
            raise Malformed(f"{len(keys)} runs are too many side by side; name at most {SIDE_BY_SIDE}")
        return list(dict.fromkeys(key_of(self.store, hexadecimal(key)) for key in keys))

    def _film(self, request: Request) -> Response:
        return self._moving(request, viewer.film)

    def _loop(self, request: Request) -> Response:
        return self._moving(request, viewer.loop)

    def _moving(self, request: Request, make: Callable[[Path], Path]) -> Response:
        """Answer with a run in motion: a WebP that `make` finds or draws."""
        key = key_of(self.store, hex_of(request))
        try:
            path = make(self.store.lab.run(key))
        except NotRecorded as error:
            raise NotFound(str(error)) from error
        return FileResponse(path, media_type="image/webp", headers={"cache-control": "private, max-age=60"})

    def _recording(self, request: Request) -> Response:
        folders = [self.store.lab.run(key) for key in self._keys(request)]
        try:
            path = viewer.recording(folders)
        except (ViewerMissing, NotRecorded) as error:
            raise NotFound(str(error)) from error
        files = (path_of(Path(), RunRecord.read(folder), None, None, "") for folder in folders)
        name = "_".join("-".join(file.parts) for file in files)
        return FileResponse(path, media_type="application/octet-stream", headers=saved_as(f"{name}.rrd"))

    def _file(self, request: Request) -> Response:
        key = key_of(self.store, hex_of(request))
        path = file_of(self.store, key, request.path_params["file"])
        return FileResponse(path, media_type="application/octet-stream", headers=saved_as(f"{key[:10]}-{path.name}"))

    def _viewer_file(self, request: Request) -> Response:
        file, version = request.path_params["file"] or "index.html", request.path_params["version"]
        try:
            if file not in viewer.FILES or version != viewer.version():
                raise NotFound(f"the viewer {version} has no file {file}")
            folder = viewer.viewer_files()
        except viewer.NoViewer as error:
            raise NotFound(str(error)) from error
        headers = dict(_LASTING)
        if file.endswith(".wasm"):
            headers |= {"content-encoding": "gzip", "rerun-final-length": (folder / f"{file}.length").read_text()}
            return FileResponse(folder / f"{file}.gz", media_type=viewer.FILES[file], headers=headers)
        return FileResponse(folder / file, media_type=viewer.FILES[file], headers=headers)

    def _static(self, request: Request) -> Response:
        content = asset(request.path_params["file"])
        if content is None:
            raise NotFound(f"there is no file {request.path_params['file']}")
        kind = _KINDS[Path(request.path_params["file"]).suffix]
        tag = f'"{hashlib.blake2b(content, digest_size=8).hexdigest()}"'
        headers = {"etag": tag, "cache-control": "private, max-age=0, must-revalidate"}
        if request.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers=headers)
        return Response(content, media_type=kind, headers=headers)

    # notes: all that the app writes

    async def _write_note(self, request: Request) -> Response:
        if self.read_only:
            raise HTTPException(403, "Notes cannot be written: the app was started with --read-only.")
        try:
            body = (await request.body()).decode("utf-8", "replace")
        except ClientDisconnect:  # the guard lets no more in
            raise HTTPException(413, f"More than {BODY_LIMIT} bytes were sent.") from None
        form = dict(parse_qsl(body, keep_blank_values=True))
        return await anyio.to_thread.run_sync(self._response, lambda _: self._save_note(request, form), request)

    def _save_note(self, request: Request, form: Mapping[str, str]) -> Response:
        kind, name = request.path_params["kind"], request.path_params["name"]
        if kind == "run":
            name = key_of(self.store, hex_of(request, "name"))
        elif kind != "study" or name not in {listing.name for listing in self.store.listings()}:
            raise NotFound(f"there is no {kind[:20]} {name[:80]}")
        tags = tuple(filter(None, (tag.strip() for tag in form.get("tags", "").split(","))))
        why = ""
        try:
            notes.write(self.store.lab, kind, name, Note(form.get("text", "").replace("\r\n", "\n").strip(), tags))
        except (ValueError, OSError) as error:
            why = str(error)
        note = Note(form.get("text", ""), tags) if why else self.store.note(kind, name)
        context = {"kind": kind, "name": name, "note": note, "why": why, "saved": not why, "read_only": False}
        return HTMLResponse(fragment("note.html.j2", LINKS, **context), 400 if why else 200)


def query_of(request: Request, page: str) -> dict[str, str]:
    """Read the query parameters of a page.

    Args:
        request: Request for the page.
        page: Name of the page in `_ALLOWED`.

    Returns:
        Values by name, without empty ones.

    Raises:
        HTTPException: 400 for a repeated or unknown parameter, or a value that is out of range.
    """
    pairs = parse_qsl(request.url.query, keep_blank_values=True)
    query = {name: value for name, value in pairs if value}
    if len(pairs) != len({name for name, _ in pairs}):
        raise HTTPException(400, "The address states a parameter twice.")
    allowed = _ALLOWED[page]
    if extras := set(query) - allowed:
        raise HTTPException(
            400, f"{sorted(extras)[0][:60]} is not known here; use: {', '.join(sorted(allowed)) or 'nothing'}"
        )
    if "page" in query and not (query["page"].isascii() and query["page"].isdigit() and len(query["page"]) < 7):
        raise HTTPException(400, "page: write a whole number, such as page=2")
    if page == "runs" and not runs.sortable(query.get("sort", "finished").removeprefix("-")):
        raise HTTPException(400, f"sort: use one of {', '.join(runs.SORTED_BY)}, with - in front for descending order")
    return query


def hex_of(request: Request, name: str = "key") -> str:
    """First digits of a run's key in a path parameter. Raises HTTPException as `hexadecimal` does."""
    return hexadecimal(request.path_params[name])


def hexadecimal(key: str) -> str:
    """Check that a text may begin a run's key, and return it. Raises HTTPException 400 if not."""
    if not 4 <= len(key) <= 64 or set(key) - set("0123456789abcdef"):
        raise HTTPException(400, f"{key[:80]} is not a key of a run; give at least four of its digits 0-9 and a-f")
    return key


def saved_as(name: str) -> dict[str, str]:
    """Headers of a download: its file name, and a plain ASCII one for older clients (RFC 6266)."""
    plain = "".join(character if character in _PLAIN else "_" for character in name)
    return {"content-disposition": f"attachment; filename=\"{plain}\"; filename*=UTF-8''{quote(name, safe='')}"}


@cache
def assets() -> dict[str, bytes]:
    """Read the static files of the app: content by path."""
    contents, folders = {}, [("", STATIC)]
    while folders:
        above, folder = folders.pop()
        for child in folder.iterdir():
            if child.is_dir():
                folders.append((f"{above}{child.name}/", child))
            elif Path(child.name).suffix in _KINDS:
                contents[f"{above}{child.name}"] = child.read_bytes()
    return contents


def asset(name: str) -> bytes | None:
    """Content of a static file of the app; None if there is none of this name."""
    if os.environ.get("LABBOOK_WEB_FRESH"):  # while the app is being written
        assets.cache_clear()
    return assets().get(name)


def _no_frame():
    import pandas as pd

    return pd.DataFrame()
