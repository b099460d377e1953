"""`labbook site`: the pages of studies as a folder of files that lacks nothing and asks nobody."""

import json
import re
import shutil
from base64 import b64decode
from functools import partial
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from labbook_web import viewer
from labbook_web.site import MARK, CannotWrite, write
from toy_lab import labbook, study_file
from toy_web import ORIFICES, REPLICATES, Read, client, keys_of, listing, make

from labbook.export.film import film, shot_of_run, source_of_film
from labbook.export.frames import NotRecorded
from labbook.export.recording import path_of
from labbook.lab import RunRecord

STUDY, POINTS = "toy-study", len(ORIFICES)


@pytest.fixture(scope="module")
def site(done, tmp_path_factory) -> Path:
    """The site of one study."""
    out = tmp_path_factory.mktemp("site") / "out"
    ended = labbook("site", out, done / "toy.yaml", "--lab", done / "lab")
    assert ended.output.splitlines()[-1] == f"Site: {out / 'index.html'}"
    return out


@pytest.fixture(scope="module")
def two(tmp_path_factory) -> tuple[Path, list[Path]]:
    """A lab with two studies, which share nothing, and their files."""
    folder = tmp_path_factory.mktemp("two")
    first = make(folder, orifices="[18, 24]", replicates=2)
    other = folder / "other.yaml"
    other.write_text(first.read_text().replace(STUDY, "other").replace("[18, 24]", "[21]"))
    labbook("run", other, "--lab", folder / "lab", "--backend", "toy")
    return folder / "lab", [first, other]


@pytest.fixture(autouse=True)
def only_svg(request, monkeypatch):
    """Figures of sites that a test writes itself are SVG only: a PDF takes as long as a figure. `site` has both."""
    if "site" not in request.fixturenames:
        monkeypatch.setattr("labbook_web.site.FILES", ("svg",))


def linked(page: Path) -> list[Path]:
    """The files that a page needs or leads to."""
    read = Read(page.read_text())
    found = []
    for link in read.links("href", "src"):
        parts = urlsplit(link)
        if not parts.path or parts.scheme == "data":
            continue  # within the page
        assert not parts.scheme, (page, link)
        assert not parts.netloc, (page, link)
        assert not parts.path.startswith("/"), (page, link)
        found.append((page.parent / unquote(parts.path)).resolve())
    return found


def sound(out: Path) -> int:
    """All pages of a site, none of whose links is dead, and which need no server; how many there are."""
    every = sorted(out.rglob("*.html"))
    for page in every:
        text = page.read_text()
        for path in linked(page):
            assert path.is_file(), (page, path)
            assert path.is_relative_to(out.resolve()), (page, path)
        for namespace in ("http://www.w3.org/2000/svg", "http://www.w3.org/1998/Math/MathML"):
            text = text.replace(namespace, "")
        assert not re.search(r"https?://|127\.0\.0\.1|localhost", text), page
        assert not re.search(r"\shx-|/static/htmx|<form[^>]+(action|hx-post)", text), f"{page} needs a server"
        for given, content in Read(text).scripts:
            assert given.get("src"), page
            assert not content.strip(), page
    return len(every)


def test_a_site_lacks_nothing(site, done):
    assert sound(site) == 1 + 1 + 1 + POINTS + POINTS * REPLICATES
    assert (site / MARK).is_file()
    reached, ahead = set(), [site / "index.html"]
    while ahead:
        page = ahead.pop()
        if page not in reached and page.suffix == ".html":
            reached.add(page)
            ahead += [path for path in map(Path, linked(page)) if path not in reached]
    assert {path.resolve() for path in reached} == {path.resolve() for path in site.rglob("*.html")}


def test_scripts_and_styles_of_a_site_name_no_other_machine(site):
    for path in [*site.rglob("*.css"), *(path for path in site.rglob("*.js") if "vendor" not in path.parts)]:
        text = path.read_text().replace("http://www.w3.org/2000/svg", "")
        assert not re.search(r"https?://|@import|url\(\s*['\"]?//", text), path


def test_every_page_has_its_twins(site, done):
    somebody = client(done / "lab")
    for page in site.rglob("*.html"):
        path = page.relative_to(site).with_suffix("").as_posix()
        for ending in ("json", "csv"):
            twin = page.with_suffix(f".{ending}")
            served = somebody.get(f"/{path}.{ending}")
            assert served.status_code == 200, path
            if path != "index":
                assert twin.read_text() == served.text, twin
        assert json.loads(page.with_suffix(".json").read_text())


def test_pages_show_what_the_server_shows(site, done):
    somebody = client(done / "lab")
    for path in (f"study/{STUDY}", f"study/{STUDY}/explore", *(f"study/{STUDY}/point/{n + 1}" for n in range(POINTS))):
        written, served = Read((site / f"{path}.html").read_text()), Read(somebody.get(f"/{path}").text)
        assert written.data == served.data, path
    points = Read((site / f"study/{STUDY}.html").read_text()).rows["points"]
    assert len(points) == 1 + POINTS
    for key in keys_of(done / "lab"):
        picture = (site / f"run/{key[:16]}/picture.png").read_bytes()
        assert picture == (done / "lab/runs" / key / "picture.png").read_bytes()
    assert (site / f"study/{STUDY}/{STUDY}.yaml").read_text() == (done / "toy.yaml").read_text()


def test_a_lab_does_not_change_by_writing_its_site(done, tmp_path):
    before = listing(done / "lab")
    labbook("site", tmp_path / "out", done / "toy.yaml", "--lab", done / "lab")
    after = listing(done / "lab")
    for one in (before, after):
        for name in ("catalogue.db-wal", "catalogue.db-shm"):
            one.pop(name, None)
    assert after == before


def test_a_second_time_replaces_the_first(done, tmp_path):
    out = tmp_path / "out"
    labbook("site", out, done / "toy.yaml", "--lab", done / "lab")
    first = set(listing(out))
    (out / "old.html").write_text("of an earlier study")
    labbook("site", out, done / "toy.yaml", "--lab", done / "lab")
    assert set(listing(out)) == first


def test_a_folder_of_something_else_is_left_alone(done, tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    ended = labbook("site", tmp_path, done / "toy.yaml", "--lab", done / "lab", check=False)
    assert ended.exit_code == 1
    assert str(tmp_path) in ended.output
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    (tmp_path / "file").write_text("mine")
    ended = labbook("site", tmp_path / "file", done / "toy.yaml", "--lab", done / "lab", check=False)
    assert ended.exit_code == 1
    assert (tmp_path / "file").read_text() == "mine"


def test_an_empty_folder_will_do(done, tmp_path):
    (tmp_path / "empty").mkdir()
    labbook("site", tmp_path / "empty", done / "toy.yaml", "--lab", done / "lab")
    assert (tmp_path / "empty/index.html").is_file()


def test_two_studies_stand_side_by_side(two, tmp_path):
    lab, files = two
    out = tmp_path / "out"
    labbook("site", out, *files, "--lab", lab)
    assert sound(out) == 1 + 2 + 1 + 3 + len(keys_of(lab)), "a study of one point has nothing to explore"
    index = Read((out / "index.html").read_text())
    assert {f"study/{STUDY}.html", "study/other.html"} <= set(index.links("href"))
    told = json.loads((out / "index.json").read_text())
    assert {one["study"] for one in told["studies"]} == {STUDY, "other"}
    assert sum(told["runs"].values()) == len(keys_of(lab))
    alone = tmp_path / "alone"
    labbook("site", alone, files[1], "--lab", lab)
    sound(alone)
    assert not (alone / f"study/{STUDY}.html").exists(), "only the studies that were given"
    only = json.loads((alone / "index.json").read_text())
    assert [one["study"] for one in only["studies"]] == ["other"]
    assert sum(only["runs"].values()) == len(list((alone / "run").glob("*.html"))) < len(keys_of(lab))


def test_a_study_without_runs_has_a_page(done, tmp_path):
    path = study_file(tmp_path, orifices="[45]")
    path.write_text(path.read_text().replace(STUDY, "later"))
    labbook("site", tmp_path / "out", path, "--lab", done / "lab")
    sound(tmp_path / "out")
    assert "No finished run" in (tmp_path / "out/study/later.html").read_text()


def test_a_study_that_cannot_be_read_is_named(done, tmp_path):
    (tmp_path / "wrong.yaml").write_text("name: [")
    ended = labbook("site", tmp_path / "out", tmp_path / "wrong.yaml", "--lab", done / "lab", check=False)
    assert ended.exit_code == 1
    assert "wrong.yaml" in ended.output
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_recordings_are_taken_along(done, tmp_path, monkeypatch):
    pytest.importorskip("rerun")
    monkeypatch.setenv("LABBOOK_CACHE", str(tmp_path / "cache"))
    labbook("site", tmp_path / "out", done / "toy.yaml", "--lab", done / "lab", "--recordings")
    found = sorted((tmp_path / "out").rglob("*.rrd"))
    assert len(found) == POINTS, "one replicate of each point kept its frames"
    assert all(path.read_bytes()[:4] == b"RRF2" for path in found)
    sound(tmp_path / "out")
    for path in found:
        page = path.parent.with_suffix(".html")
        assert f"{path.parent.name}/recording.rrd" in " ".join(Read(page.read_text()).links("href"))


@pytest.mark.slow
def test_films_are_on_the_pages_of_their_runs(done, tmp_path, monkeypatch):
    """One run of the lab has a film, which is taken along in any case; with --films the others are made."""
    monkeypatch.setenv("LABBOOK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("labbook.export.film.film", partial(film, seconds=0.1, size=40))
    lab = tmp_path / "lab"
    shutil.copytree(done / "lab", lab)
    recorded = sorted(path.parent for path in lab.glob("runs/*/recording.npz"))
    record = RunRecord.read(recorded[0])
    path = path_of(lab / "films", record, None, None, "-layers.webp")
    film(shot_of_run(recorded[0], "layers"), path, seconds=0.1, size=50, source=source_of_film(record))
    assert [viewer.stored_film(folder) for folder in recorded] == [path, *(None for _ in recorded[1:])]
    labbook("site", tmp_path / "out", done / "toy.yaml", "--lab", lab, "--films")
    taken = sorted((tmp_path / "out").rglob("film.webp"))
    assert len(taken) == len(recorded) == POINTS
    assert [one.read_bytes() == path.read_bytes() for one in taken] == [True, *(False for _ in recorded[1:])]
    for one in taken:
        page = Read(one.parent.with_suffix(".html").read_text())
        assert f"{one.parent.name}/film.webp" in " ".join(page.links("src"))
    sound(tmp_path / "out")
    path.write_bytes(path.read_bytes().replace(record.run_key.encode(), b"0" * len(record.run_key)))
    assert viewer.stored_film(recorded[0]) is None, "a film of another run"


def test_without_the_viewer_recordings_are_refused(done, tmp_path, monkeypatch):
    def recording(folder):
        raise NotRecorded("the viewer is not installed; install it: pip install 'labbook[viewer]'")

    monkeypatch.setattr(viewer, "recording", recording)
    with pytest.raises(CannotWrite, match="labbook\\[viewer\\]"):
        write(tmp_path / "out", done / "lab", [done / "toy.yaml"], recordings=True)


def test_a_lab_that_is_not_there_is_named(done, tmp_path):
    ended = labbook("site", tmp_path / "out", done / "toy.yaml", "--lab", tmp_path / "none", check=False)
    assert ended.exit_code == 1
    assert "there is no lab" in ended.output


def test_the_viewer_is_asked_to_play_from_the_middle_of_the_window(monkeypatch):
    """Bytes of the message by hand, after the rules of Protocol Buffers: set_time_cursor (6) with the timeline (2), the
    time (3) of 5e8 ns and the state (5) `playing`."""
    monkeypatch.setattr(viewer, "middle_of", lambda folders: 0.5)
    timeline, instant = b"\x12\x0a\x0a\x08sim_time", b"\x1a\x06\x08\x80\xca\xb5\xee\x01"
    assert b64decode(viewer.opening([])) == b"\x32\x16" + timeline + instant + b"\x28\x02"
