"""What strangers send is refused in plain words: addresses, bodies, hosts, tokens; what they wrote stays text."""

import contextlib
import json
import os
import re
import socket
import string
import threading
from pathlib import Path
from urllib.parse import quote, unquote, urlencode

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labbook_web import connections
from labbook_web.app import application
from labbook_web.guard import ADDRESS_LIMIT, BODY_LIMIT, COOKIE, POLICY, VIEWER_POLICY
from labbook_web.serve import server
from labbook_web.site import write
from labbook_web.store import LabStore
from toy_lab import labbook, unsealed
from toy_web import HOST, ORIFICES, Read, ask, client, everything, keys_of, listing, make

from labbook.lab import LabFolder, notes
from labbook.lab.database import open_engine, runs
from labbook.lab.notes import Note

STUDY, POINTS = "toy-study", len(ORIFICES)
OURS = {"origin": f"http://{HOST}", "content-type": "application/x-www-form-urlencoded"}


@pytest.fixture(scope="module")
def app(done):
    """The app of the lab that nobody changes."""
    return application(LabStore(done / "lab"))


@pytest.fixture(scope="module")
def key(done) -> str:
    """A run of it."""
    return keys_of(done / "lab")[0][:16]


def refused(answer, done: Path) -> None:
    """A clear refusal, which tells nothing of the machine or of the code."""
    assert 400 <= answer.status < 500, answer.text[-500:]
    assert answer.content.strip(), "it says why"
    for word in ("Traceback", "site-packages", "root:x:", ".py", str(done), "/home/", "Errno"):
        assert word not in answer.text, word
    assert answer.headers["content-security-policy"] in (POLICY, VIEWER_POLICY)
    assert "set-cookie" not in answer.headers


PLACES = (
    "/", "/study/", f"/study/{STUDY}/", f"/study/{STUDY}/point/", f"/study/{STUDY}/figure/", "/run/", "/run/KEY/",
    "/run/KEY/file/", "/card/", "/progress/", "/static/", "/static/vendor/", "/viewer/", "/viewer/0.41.0/",
    "/note/study/", "/note/run/", "/beside/", "/beside/KEY-",
)  # fmt: skip
ODD = (
    "../../../../../../etc/passwd", "..%2f..%2f..%2f..%2fetc%2fpasswd", "%2e%2e/%2e%2e/%2e%2e/etc/passwd",
    "%2e%2e%2f%2e%2e%2fcatalogue.db", "/etc/passwd", "%2fetc%2fpasswd", "..", "%2e%2e", ".", "../run.json",
    "..%2f..%2fcatalogue.db", "..%5c..%5ccatalogue.db", "%252e%252e%252fetc%252fpasswd", "%c0%ae%c0%ae/etc/passwd",
    "run.json%00", "%00", "x%00.png", "%ff%fe", "%F0%9F%A7%AA", "<script>alert(1)</script>", "%3Cscript%3Ealert(1)",
    "'%22--", "%0d%0aset-cookie:%20a=b", "$(id)", "{{7*7}}", "-1", "1e9", "1.5", "99999999999999999999999999", "%20",
    "a" * 300, "a" * 3000, "%e2%80%ae", "CON", "evaluation.lock", ".lock",
)  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_no_odd_address_leads_anywhere(app, done, key, place, method):
    for odd in ODD:
        target = (place.replace("KEY", key) + odd).encode()
        answer = ask(app, target, method, OURS if method == "POST" else {})
        if answer.status in (301, 307):  # a slash at the end
            assert answer.headers["location"].startswith(f"http://{HOST}/")
            continue
        refused(answer, done)
        assert b"<script>alert" not in answer.content


def test_links_within_the_folder_of_a_run_are_not_followed(copied):
    key = keys_of(copied / "lab")[0]
    folder = copied / "lab/runs" / key
    (folder / "passwd").symlink_to("/etc/passwd")
    (folder / "index").symlink_to(copied / "lab/catalogue.db")
    (folder / "deeper").mkdir()
    (folder / ".hidden").write_text("secret")
    somebody = client(copied / "lab")
    for name in ("passwd", "index", "deeper", ".hidden"):
        assert somebody.get(f"/run/{key[:16]}/file/{name}").status_code == 404, name
        assert f"/file/{name}" not in somebody.get(f"/run/{key[:16]}").text


def test_a_lab_that_names_a_study_by_a_link_shows_no_other_file(copied):
    """A study file is read as a study; what is none is not shown."""
    (copied / "lab/study-files/linked.yaml").symlink_to("/etc/passwd")
    somebody = client(copied / "lab")
    for address in ("/card/linked", "/study/linked", "/study/linked/linked.yaml", "/study/linked.json"):
        assert "root:x:" not in somebody.get(address).text


SECRET = "root:x:0:0"


def linked(folder: Path, key: str) -> list[str]:
    """Put links into a lab, wherever the app reads a file as it is; the addresses under which they would be shown."""
    secret = folder / "secret.md"
    secret.write_text(SECRET)
    lab = folder / "lab"
    (lab / "runs" / key / "picture.png").unlink()
    (lab / "runs" / key / "picture.png").symlink_to(secret)
    for note in (f"runs/{key}", f"studies/{STUDY}"):
        (lab / "notes" / note).parent.mkdir(parents=True, exist_ok=True)
        (lab / f"notes/{note}.md").symlink_to(secret)
    return [f"/run/{key[:16]}/picture.png", f"/run/{key[:16]}", f"/study/{STUDY}", "/"]


def test_links_in_place_of_pictures_and_notes_are_not_followed(copied, tmp_path):
    key = keys_of(copied / "lab")[0]
    somebody = client(copied / "lab")
    for address in linked(copied, key):
        answer = somebody.get(address)
        assert answer.status_code == 200
        assert SECRET not in answer.text, address
    assert somebody.get(f"/run/{key[:16]}/picture.png").headers["content-type"] == "image/svg+xml"
    assert "it is a link" in somebody.get(f"/run/{key[:16]}").text
    assert "it is a link" in labbook("show", key, "--lab", copied / "lab").output
    write(tmp_path / "site", copied / "lab", [copied / "toy.yaml"])
    assert not [
        path
        for path in (tmp_path / "site").rglob("*")
        if path.is_file() and SECRET in path.read_bytes().decode("latin-1")
    ]


def test_a_run_whose_folder_is_a_link_shows_no_file_of_it(copied):
    key, other = keys_of(copied / "lab")[:2]
    folder, elsewhere = copied / "lab/runs" / key, copied / "elsewhere"
    folder.rename(elsewhere)
    (elsewhere / "secret.txt").write_text(SECRET)
    folder.symlink_to(elsewhere)
    somebody = client(copied / "lab")
    assert somebody.get(f"/run/{key[:16]}/file/secret.txt").status_code == 404
    assert somebody.get(f"/run/{key[:16]}/file/run.json").status_code == 404
    page = somebody.get(f"/run/{key[:16]}")
    assert (page.status_code, "it is a link" in page.text) == (200, True)
    assert somebody.get(f"/run/{other[:16]}").status_code == 200


FILE_NAMES = ("größe€.txt", 'quo"te.txt', "line\nfeed.txt", "cr\r.txt", "ta\tb.txt", "per%cent.txt", "semi;colon.txt",
         "back\\slash.txt", "日本.txt", "\u202eturned.txt", "b l a n k.txt", "<b>.txt", "'quoted'.txt")  # fmt: skip


def test_files_of_any_name_are_handed_out_under_it(copied):
    key = keys_of(copied / "lab")[0]
    folder, somebody = copied / "lab/runs" / key, client(copied / "lab")
    for name in FILE_NAMES:
        (folder / name).write_text(name)
    (folder / os.fsdecode(b"not \xff text.txt")).write_text("bytes")
    page = somebody.get(f"/run/{key[:16]}")
    assert page.status_code == 200
    assert "not " not in re.findall(r"Downloads.*?</section>", page.text, re.DOTALL)[0]
    app = application(LabStore(copied / "lab"))
    for name in FILE_NAMES:
        assert quote(name) in page.text
        answer = ask(app, f"/run/{key[:16]}/file/{quote(name)}".encode())
        assert (answer.status, answer.content) == (200, name.encode()), name
        told = answer.headers["content-disposition"]
        assert re.fullmatch(r"attachment; filename=\"[\w. -]+\"; filename\*=UTF-8''[\w.%~-]+", told, re.ASCII)
        assert unquote(told.partition("UTF-8''")[2]) == f"{key[:10]}-{name}"


def test_a_run_of_a_study_of_no_name_does_not_break_the_pages(copied):
    """It was indexed before names were looked at."""
    with open_engine(LabFolder(copied / "lab"), read_only=False).connect() as connection:
        connection.execute(runs.update().where(runs.c.run_key == keys_of(copied / "lab")[0]).values(study="<b>x"))
        connection.commit()
    somebody = client(copied / "lab")
    for address in ("/", "/index.json", "/runs", f"/study/{STUDY}", "/compare", f"/compare?item=study:{STUDY}"):
        assert somebody.get(address).status_code == 200, address
    assert somebody.get("/study/%3Cb%3Ex").status_code == 404


@pytest.mark.slow
def test_half_open_connections_keep_nobody_from_an_answer_and_are_closed(done, monkeypatch):
    """64 of them made every other request wait, for as long as they were held."""
    monkeypatch.setattr(connections, "HEADER_TIMEOUT", 3.0)
    listening = socket.create_server(("127.0.0.1", 0))
    address = listening.getsockname()
    serving = server(application(LabStore(done / "lab")))
    thread = threading.Thread(target=serving.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    try:
        half_open = [socket.create_connection(address, timeout=30) for _ in range(100)]
        for k, one in enumerate(half_open):
            one.sendall((b"", b"GET / HTTP/1.1\r\n", b"GET / HTTP/1.1\r\nhost: x\r\nx: ")[k % 3])
        with socket.create_connection(address, timeout=30) as other:
            other.sendall(b"GET /static/icon.svg HTTP/1.1\r\nhost: x\r\n\r\n")
            assert other.recv(100).startswith(b"HTTP/1.1 200 ")
            half = half_open[0]
            half.setblocking(False)
            with pytest.raises(BlockingIOError):  # they are there meanwhile
                half.recv(1)
            half.settimeout(30)
        for one in half_open:
            with one, contextlib.suppress(ConnectionResetError):
                assert one.recv(1) == b""
    finally:
        serving.should_exit = True
        thread.join(30)


@pytest.mark.slow
def test_of_very_many_half_open_connections_the_oldest_is_closed(done, monkeypatch):
    monkeypatch.setattr(connections, "PENDING_LIMIT", 10)
    monkeypatch.setattr(connections, "HEADER_TIMEOUT", 600.0)
    listening = socket.create_server(("127.0.0.1", 0))
    serving = server(application(LabStore(done / "lab")))
    thread = threading.Thread(target=serving.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    try:
        half_open = [socket.create_connection(listening.getsockname(), timeout=30) for _ in range(11)]
        with contextlib.suppress(ConnectionResetError):
            assert half_open[0].recv(1) == b""
        half_open[-1].sendall(b"GET /static/icon.svg HTTP/1.1\r\nhost: x\r\n\r\n")
        assert half_open[-1].recv(100).startswith(b"HTTP/1.1 200 ")
        for one in half_open:
            one.close()
    finally:
        serving.should_exit = True
        thread.join(30)


QUERIES = [
    ("/", "no=1"), ("/", "page=0"), ("/", "page=-1"), ("/", "page=1000000000"), ("/", "page=abc"), ("/", "page=1.0"),
    ("/", "page=%D9%A1"), ("/", "page=1&page=1"), ("/", "q=a&q=b"), ("/runs", "no=1"), ("/runs", "page=0"),
    ("/runs", "page=-1"), ("/runs", "page=1e9"), ("/runs", "page=999999"), ("/runs", "page=99999999999999999999"),
    ("/runs", "page=abc"), ("/runs", "page=%00"), ("/runs", "sort=none"), ("/runs", "sort=--seed"),
    ("/runs", "sort=problem%20desc"), ("/runs", "sort=1;drop%20table%20runs"), ("/runs", "study=a&study=b"),
    ("/runs", "page=1&page="), (f"/study/{STUDY}", "no=1"), (f"/study/{STUDY}", "backend=none"),
    (f"/study/{STUDY}", "backend=../.."), (f"/study/{STUDY}", "backend=toy&backend=twin"),
    (f"/study/{STUDY}", "as=1&as=2"),
    (f"/study/{STUDY}/point/1", "no=1"), (f"/study/{STUDY}/point/1", "backend=%00"), (f"/study/{STUDY}/point/0", ""),
    (f"/study/{STUDY}/point/5", ""), (f"/study/{STUDY}/point/99999999999999999999", ""), ("/run/KEY", "no=1"),
    ("/compare", "no=1"), ("/compare", "item=" + "&item=".join(f"run:{k:04x}" for k in range(7))),
    ("/compare", "item=run:%00"), ("/compare", "item=point:a:99999999"), (f"/progress/{STUDY}", "backend=none"),
    (f"/study/{STUDY}/figure/patterns", "backend=none"),
]  # fmt: skip


@pytest.mark.parametrize(("path", "query"), QUERIES)
def test_what_a_page_does_not_know_is_refused(app, done, key, path, query):
    target = f"{path.replace('KEY', key)}?{query}".encode()
    refused(ask(app, target), done)
    if path.startswith(("/runs", "/study", "/run/")) and "/figure" not in path:
        told = ask(app, target.replace(b"?", b".json?", 1))
        refused(told, done)
        assert json.loads(told.text)["error"]


def test_what_is_not_known_is_named(app):
    assert "colour is not known here" in ask(app, b"/runs?colour=red").text
    assert "a parameter twice" in ask(app, b"/runs?q=a&q=b").text
    assert "whole number" in ask(app, b"/runs?page=abc").text


def test_addresses_have_a_longest_length(app, done):
    for target in (b"/runs?q=" + b"a" * ADDRESS_LIMIT, b"/" + b"a" * ADDRESS_LIMIT):
        answer = ask(app, target)
        assert answer.status == 414
        refused(answer, done)
    assert ask(app, b"/runs?q=" + b"a" * 3000).status == 200, "what is long, but not too long, is looked for"


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT", "BREW"])
def test_other_methods_are_refused(app, done, method):
    for target in (b"/", b"/runs", f"/note/study/{STUDY}".encode(), b"/static/labbook.css"):
        answer = ask(app, target, method, OURS)
        assert answer.status == 405
        refused(answer, done)


def test_pages_are_not_posted_to(app, done, key):
    for page in ("/", "/runs", f"/study/{STUDY}", f"/run/{key}", "/compare", "/static/labbook.css"):
        answer = ask(app, page.encode(), "POST", OURS)
        assert answer.status == 405, page
        refused(answer, done)


@pytest.mark.parametrize("announced", [True, False])
def test_bodies_have_a_largest_size(copied, announced):
    app = application(LabStore(copied / "lab"))
    pieces = [b"text=", *[b"a" * 10_000] * (BODY_LIMIT // 10_000 + 1)]
    headers = {**OURS, "content-length": str(sum(map(len, pieces)))} if announced else OURS
    answer = ask(app, f"/note/study/{STUDY}".encode(), "POST", headers, pieces)
    assert answer.status == 413
    assert not (copied / "lab/notes").exists()
    small = [b"text=", b"a" * 10_000]
    assert ask(app, f"/note/study/{STUDY}".encode(), "POST", OURS, small).status == 200


@pytest.mark.parametrize("length", ["-1", "abc", "1e3", "99999999999999999999"])
def test_lengths_that_are_none_are_refused(app, done, length):
    answer = ask(app, f"/note/study/{STUDY}".encode(), "POST", {**OURS, "content-length": length}, [b"text=a"])
    assert answer.status in (400, 413)
    refused(answer, done)


@pytest.mark.parametrize(
    "body",
    [b"", b"\xff\xfe\x00", b"text=%ff%00%ed%a0%80", b"text=a&text=b&tags=&&&=", b"{}", b"text=" + b"%0d" * 30_000],
)
def test_whatever_a_note_has_in_it_is_kept_or_refused(copied, body):
    app = application(LabStore(copied / "lab"))
    answer = ask(app, f"/note/study/{STUDY}".encode(), "POST", OURS, [body])
    assert answer.status in (200, 400)
    assert ask(app, f"/study/{STUDY}".encode()).status == 200


def test_hosts_of_other_names_are_refused(done):
    app = application(LabStore(done / "lab"), hosts=frozenset({"127.0.0.1:8321", "localhost:8321"}))
    for host, status in (
        ("127.0.0.1:8321", 200),
        ("localhost:8321", 200),
        ("127.0.0.1", 421),
        ("127.0.0.1:80", 421),
        ("evil.example", 421),
        ("evil.example:8321", 421),
        ("localhost:8321.evil.example", 421),
        ("", 421),
    ):
        answer = ask(app, b"/runs", headers={"host": host})
        assert answer.status == status, host
        if status != 200:
            refused(answer, done)


def test_a_token_opens_the_app(done):
    app = application(LabStore(done / "lab"), token="secret-token")
    for target in (b"/", b"/runs", b"/static/labbook.css", b"/?token=wrong", b"/?token=", b"/?token=secret-toke"):
        answer = ask(app, target)
        assert answer.status == 401, target
        refused(answer, done)
        assert "secret" not in answer.text
    let = ask(app, b"/?token=secret-token")
    assert let.status == 303
    assert let.headers["location"] == "/", "the token does not stay in the address"
    cookie = let.headers["set-cookie"]
    assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
    assert let.headers["content-security-policy"] == POLICY
    pair = cookie.partition(";")[0]
    assert ask(app, b"/", headers={"cookie": pair}).status == 200
    assert ask(app, b"/runs", headers={"cookie": f"other=1; {pair}"}).status == 200
    for wrong in (f"{COOKIE}=wrong", f"{COOKIE}=", "=;;\x00", f"{COOKIE}=secret-token%00", f"x{pair}"):
        assert ask(app, b"/", headers={"cookie": wrong}).status == 401, wrong


def test_a_token_asks_for_the_page_that_was_meant(done):
    app = application(LabStore(done / "lab"), token="secret-token")
    let = ask(app, f"/study/{STUDY}?token=secret-token".encode())
    assert (let.status, let.headers["location"]) == (303, f"/study/{STUDY}")
    for odd in (b"//elsewhere.example/?token=secret-token", b"/%2felsewhere.example?token=secret-token"):
        answer = ask(app, odd)
        assert not answer.headers.get("location", "").startswith(("//", "http://elsewhere")), "leads to another machine"


@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.7", "::", "example.org"])
def test_other_machines_are_let_in_only_when_asked_for(done, host):
    ended = labbook("web", "--no-open", "--host", host, "--lab", done / "lab", check=False)
    assert ended.exit_code == 1
    assert "--remote" in ended.output
    assert "Traceback" not in ended.output


def test_a_port_that_is_taken_is_said(done):
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        ended = labbook("web", "--no-open", "--port", taken.getsockname()[1], "--lab", done / "lab", check=False)
    assert ended.exit_code == 1
    assert "--port" in ended.output


# what answers carry


def test_every_answer_carries_the_policy(done, app, key):
    targets = [*everything(done / "lab", STUDY, POINTS), "/none", "/run/zz", "/static/labbook.js", "/favicon.ico",
               f"/run/{key}/file/run.json", "/viewer/0/index.html", "/runs?no=1",
               f"/study/{STUDY}/figure/patterns"]  # fmt: skip
    for target in targets:
        answer = ask(app, target.encode())
        assert answer.headers["content-security-policy"] == (VIEWER_POLICY if "/viewer/" in target else POLICY), target
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["cache-control"]
    for target, method, headers in (
        (b"/", "DELETE", {}),
        (b"/note/study/x", "POST", {}),
        (b"/" + b"a" * 5000, "GET", {}),
    ):
        assert ask(app, target, method, headers).headers["content-security-policy"] == POLICY


def test_the_policy_of_pages_lets_no_script_stand_in_them():
    said = {name: value for name, _, value in (part.strip().partition(" ") for part in POLICY.split(";"))}
    assert said["script-src"] == "'self'"
    assert said["default-src"] == "'none'"
    assert "connect-src" in said
    for name, value in said.items():
        assert not re.search(r"https?:|\*|unsafe-eval", value), name
        assert "unsafe-inline" not in value or name == "style-src"


NAMESPACES = ("http://www.w3.org/2000/svg", "http://www.w3.org/1998/Math/MathML", "http://www.w3.org/1999/xlink")


def is_plain(text: str, where: str) -> None:
    """A page or part of one has no script of its own within, and names no address elsewhere."""
    page = Read(text)
    for tag, given_ in page.elements:
        assert not [name for name in given_ if name.startswith("on")], (where, tag)
        assert tag not in ("base", "object", "embed", "applet"), where
        for name in ("href", "src", "action", "formaction", "hx-get", "hx-post", "data-address", "poster", "srcset"):
            value = given_.get(name, "").strip().lower()
            assert not value.startswith(("javascript:", "data:text", "vbscript:", "//")), (where, tag, value)
    for given_, content in page.scripts:
        assert given_.get("src"), where
        assert not content.strip(), where
    for namespace in NAMESPACES:
        text = text.replace(namespace, "")
    assert not re.search(r"https?://", text), (where, re.findall(r"https?://.{40}", text))


def test_pages_have_no_script_and_name_no_other_machine(done):
    somebody = client(done / "lab")
    for address in everything(done / "lab", STUDY, POINTS):
        answer = somebody.get(address)
        if answer.headers["content-type"].startswith("text/html"):
            is_plain(answer.text, address)
    for address in (f"/study/{STUDY}/figure/patterns", f"/study/{STUDY}/figure/flow-over-time", "/none", "/runs?no=1"):
        is_plain(somebody.get(address).text, address)


# what people write stays text


EVIL = (
    "<script>alert('x')</script>\"'><img src=x onerror=alert(1)></textarea></script></pre>&amp;{{7*7}}${1}ü🧪 a_<b>^(2)"
)


@pytest.fixture(scope="module")
def hostile(tmp_path_factory) -> Path:
    """A lab in which everything that people can write is hostile: the text of a study, notes, and what runs that were
    imported say of themselves."""
    folder = tmp_path_factory.mktemp("hostile")
    quoted = json.dumps(EVIL, ensure_ascii=False)
    make(folder, f"about: {quoted}", f"# {EVIL}", orifices="[18, 24]", replicates=2)
    lab = folder / "lab"
    for key in keys_of(lab):
        record = lab / "runs" / key / "run.json"
        told = json.loads(unsealed(record.read_text()))
        told["label"] = f"{EVIL}{told['label']}"
        told["device"] = EVIL
        told["sessions"][-1]["provenance"] |= {EVIL: EVIL, "commit": EVIL}
        record.write_text(json.dumps(told))
    labbook("reindex", "--lab", lab)
    notes.write(LabFolder(lab), "study", STUDY, Note(EVIL, ("ünï-🧪"[:3],)))
    notes.write(LabFolder(lab), "run", keys_of(lab)[0], Note(EVIL, ("tag",)))
    return lab


def test_hostile_words_are_shown_as_they_are(hostile):
    somebody = client(hostile)
    addresses = everything(hostile, STUDY, 2)
    addresses += [f"/?{urlencode({'q': EVIL})}", f"/runs?{urlencode({'q': EVIL})}", f"/study/{quote(EVIL)}"]
    addresses += [f"/compare?item={quote(EVIL)}", f"/runs?{urlencode({'sort': EVIL})}", f"/runs?{quote(EVIL)}=1"]
    addresses += [f"/study/{STUDY}?{urlencode({'as': EVIL})}", f"/study/{STUDY}?{urlencode({'backend': EVIL})}"]
    addresses += [f"/study/{STUDY}/figure/{quote(EVIL, safe='')}", f"/runs?{urlencode({'tag': EVIL, 'packing': EVIL})}"]
    shown = 0
    for address in addresses:
        answer = somebody.get(address)
        assert answer.status_code < 500, address
        if not answer.headers["content-type"].startswith("text/html"):
            assert "json" not in answer.headers["content-type"] or json.loads(answer.text)
            continue
        is_plain(answer.text, address)
        page = Read(answer.text)
        assert not [given for tag, given in page.elements if tag == "img" and given.get("src") == "x"], address
        assert "amp;49" not in page.words, "templates within words are not carried out"
        assert not re.search(r"<script>alert|<img src=x", answer.text), address
        shown += "alert('x')" in page.words
    assert shown >= 10, "hostile words are shown, not left out"


def test_hostile_notes_come_back_whole(hostile):
    form = client(hostile).get(f"/study/{STUDY}").text
    (inside,) = re.findall(r"<textarea[^>]*>(.*?)</textarea>", form, re.DOTALL)
    import html

    assert html.unescape(inside) == EVIL


def test_figures_and_sketches_of_hostile_labs_are_plain(hostile):
    somebody = client(hostile)
    for figure in ("flow-over-time", "patterns"):
        drawn = somebody.get(f"/study/{STUDY}/figure/{figure}.svg")
        if drawn.status_code == 200:
            assert "<script" not in drawn.text
            assert "onerror=" not in drawn.text.replace("&lt;", "")


# anything at all


WORDS = (
    "study", "point", "run", "runs", "compare", "beside", "card", "progress", "note", "static", "viewer", "figure",
    "file", STUDY, "index.json", "runs.csv", "picture.png", "recording.rrd", "1", "0", "-1", "..", ".", "", "%2f",
    "%00",
    "a.json", ".yaml", f"{STUDY}.yaml", "vendor", "labbook.css", "0.41.0", "1.json", "%ff", "é", "x" * 400,
)  # fmt: skip
NAMES = ("q", "page", "sort", "study", "backend", "outcome", "packing", "tag", "item", "as", "x", "token", "state", "")
text = st.text(st.characters(codec="utf-8"), max_size=40)
values = st.one_of(
    text, st.integers().map(str), st.sampled_from(["run:", "point:a:1", f"study:{STUDY}", "-seed", "%", "_"])
)
paths = st.lists(st.one_of(st.sampled_from(WORDS), text.map(lambda one: quote(one, safe=""))), max_size=6)
queries = st.lists(st.tuples(st.one_of(st.sampled_from(NAMES), text), values), max_size=4)


@settings(max_examples=400)
@given(paths, queries, st.sampled_from(["GET", "HEAD", "POST"]), st.binary(max_size=200))
def test_nothing_that_is_asked_breaks_the_app(app, done, path, query, method, body):
    target = quote("/" + "/".join(path), safe="/%") + "?" + urlencode(query)
    before = listing(done / "lab/study-files")
    answer = ask(app, target.encode(), method, OURS if method == "POST" else {}, [body])
    assert answer.status < 500, target
    assert "Traceback" not in answer.text
    assert listing(done / "lab/study-files") == before


@settings(max_examples=200)
@given(st.text(string.printable, max_size=60).map(lambda one: one.encode()), st.binary(max_size=60))
def test_queries_of_any_bytes_do_not_break_it(app, path, query):
    target = b"/" + quote(path, safe="/%").encode() + b"?" + bytes(one for one in query if 32 < one < 127)
    answer = ask(app, target)
    assert answer.status < 500, target
