"""What tests of the web app share: labs to show, all addresses of a lab, and ways to ask for them."""

import asyncio
import io
import json
import re
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote_to_bytes

import pandas as pd
import toy_lab
from labbook_web.app import application
from labbook_web.store import LabStore
from starlette.testclient import TestClient
from toy_lab import labbook, study_file

from labbook.lab import Catalogue

HOST = "testserver"
ORIFICES = (18, 21, 24, 30)  # mm
REPLICATES = 3


def make(folder: Path, *more: str, measure: str = "flow_rate", **changes) -> Path:
    """A study file with two laws fitted and a recording a point, carried out in `folder/lab` by the toy backend."""
    given = {"count": 400, "replicates": REPLICATES, "orifices": f"[{', '.join(map(str, ORIFICES))}]"} | changes
    path = study_file(folder, "fit: [beverloo, janda]", "record: {every: 5 ms, replicates: 1}", *more, **given)
    path.write_text(path.read_text().replace("[flow_rate]", f"[{measure}]"))
    ended = labbook("run", path, "--lab", folder / "lab", "--backend", "toy", check=False)
    assert ended.exit_code == ("No point of the study has a flow rate" in ended.stdout), ended.output
    return path


def client(lab: Path, given: Sequence[Path] = (), **options) -> TestClient:
    """Somebody who asks the app of a lab; what breaks within it is answered by 500, as in a server."""
    app = application(LabStore(lab, given), **options)
    return TestClient(app, f"http://{HOST}", raise_server_exceptions=False, follow_redirects=False)


def keys_of(lab: Path) -> list[str]:
    """Keys of all runs of a lab, in their order."""
    catalogue = Catalogue(lab)
    keys = sorted(catalogue.runs()["run_key"])
    catalogue.close()
    return keys


def pages(lab: Path, study: str, points: int) -> list[str]:
    """Addresses of all pages of a lab with one study, without those of twins."""
    found = ["/", "/runs", f"/study/{study}"]
    found += [f"/study/{study}/explore"] if points > 1 else []
    found += [f"/study/{study}/point/{number}" for number in range(1, points + 1)]
    keys = keys_of(lab)
    found += [f"/run/{key[:16]}" for key in keys]
    items = [f"item=run:{key[:16]}" for key in keys[:2]]
    return [*found, "/compare", f"/compare?{'&'.join(items)}", f"/compare?item=study:{study}&item=study:{study}@twin",
            *([f"/compare?item=point:{study}:1&item=point:{study}:2"] if points > 1 else [])]  # fmt: skip


def twins(page: str, ending: str) -> str:
    """The address of the same page as `json` or `csv`."""
    path, mark, query = page.partition("?")
    return f"{'/index' if path == '/' else path}.{ending}{mark}{query}"


def everything(lab: Path, study: str, points: int) -> list[str]:
    """Addresses of all pages of a lab with one study, their twins and parts, and files; no viewer."""
    shown = pages(lab, study, points)
    found = [*shown, *(twins(page, ending) for page in shown for ending in ("json", "csv"))]
    found += [f"/card/{study}", f"/progress/{study}", f"/study/{study}/{study}.yaml"]
    return found + [f"/run/{key[:16]}/picture.png" for key in keys_of(lab)]


def twin_table(text: str) -> pd.DataFrame:
    """The table of a CSV twin; units of headings are left out."""
    frame = pd.read_csv(io.StringIO(text), keep_default_na=False, na_values=[""])
    return frame.rename(columns={name: re.sub(r" \[[^]]*\]$", "", name) for name in frame})


def listing(folder: Path) -> dict[str, tuple[int, int]]:
    """Size and time of change of every file and folder."""
    found = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        found[path.relative_to(folder).as_posix()] = (status.st_size if path.is_file() else 0, status.st_mtime_ns)
    return found


class Read(HTMLParser):
    """What a page has: its elements with their attributes, the text of its tables, and its data for scripts."""

    def __init__(self, text: str):
        super().__init__()
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.rows: dict[str, list[list[str]]] = {}
        self.scripts: list[tuple[dict[str, str], str]] = []
        self.words = ""
        self._table, self._cell, self._script = "", False, False
        self._data, self._inside = "", False
        self.feed(text)

    @property
    def data(self) -> dict:
        """What the scripts of the page draw."""
        return json.loads(self._data)

    def links(self, *names: str) -> list[str]:
        """Values of these attributes, such as `href` and `src`."""
        return [given[name] for _, given in self.elements for name in names if name in given]

    def one(self, **wanted: str) -> dict[str, str]:
        """The attributes of the only element that has these."""
        (found,) = (given for _, given in self.elements if wanted.items() <= given.items())
        return found

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.elements.append((tag, given))
        self._inside |= given.get("id") == "data"
        if tag == "table":
            self._table = given.get("id", f"table {len(self.rows)}")
            self.rows[self._table] = []
        elif tag == "tr" and self._table:
            self.rows[self._table].append([])
        elif tag in ("td", "th") and self._table:
            self._cell = True
            self.rows[self._table][-1].append("")
        elif tag == "script":
            self._script = True
            self.scripts.append((given, ""))

    def handle_endtag(self, tag: str) -> None:
        self._inside &= tag != "pre"
        if tag == "table":
            self._table = ""
        elif tag in ("td", "th"):
            self._cell = False
        elif tag == "script":
            self._script = False

    def handle_data(self, data: str) -> None:
        if self._inside:
            self._data += data
            return
        if self._script:
            given, text = self.scripts[-1]
            self.scripts[-1] = given, text + data
            return
        self.words += data
        if self._cell and self._table:
            self.rows[self._table][-1][-1] += data


@dataclass
class Answer:
    """What the app sent."""

    status: int = 0
    headers: dict[str, str] = field(default_factory=dict)
    content: bytes = b""

    @property
    def text(self) -> str:
        """Its content as text."""
        return self.content.decode("utf-8", "replace")


def ask(app, target: bytes, method: str = "GET", headers: Mapping[str, str] | None = None, body: Sequence[bytes] = ()):
    """What an app answers to an address as it stands on the wire, which no client has tidied up before; a body comes in
    pieces, without a length."""
    path, _, query = target.partition(b"?")
    given = {"host": HOST, **(headers or {})}
    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": method, "scheme": "http",
        "path": unquote_to_bytes(path).decode("utf-8", "replace"), "raw_path": path, "query_string": query,
        "root_path": "", "headers": [(name.encode(), value.encode("latin-1")) for name, value in given.items()],
        "client": ("127.0.0.1", 1), "server": (HOST, 80),
    }  # fmt: skip
    pieces = list(body) or [b""]
    answer = Answer()

    async def receive():
        if not pieces:
            await asyncio.sleep(30)
            return {"type": "http.disconnect"}
        return {"type": "http.request", "body": pieces.pop(0), "more_body": bool(pieces)}

    async def send(message):
        if message["type"] == "http.response.start":
            answer.status = message["status"]
            answer.headers = {name.decode(): value.decode("latin-1") for name, value in message["headers"]}
        else:
            answer.content += message.get("body", b"")

    async def whole():
        try:
            await app(scope, receive, send)
        except Exception:  # a server logs it, after it has answered 500
            if not answer.status:
                raise

    asyncio.run(whole())
    return answer


@contextmanager
def serving(lab: Path, *words: object) -> Iterator[str]:
    """`labbook web` as a process of its own; the address that it prints, without a slash at its end."""
    process = toy_lab.start("web", *words, "--no-open", "--port", 0, "--lab", lab)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found, line + (process.stderr.read() if process.stderr else "")
        yield found[0].rstrip("/")
    finally:
        process.terminate()
        try:
            process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


def wait_until(there, seconds: float = 30.0) -> None:
    """Until `there()` is true; fails after some time."""
    end = time.monotonic() + seconds
    while not there():
        assert time.monotonic() < end, f"not so within {seconds} s"
        time.sleep(0.05)
