"""The pages of a lab show what `labbook.results` finds, as HTML, JSON and CSV, and say plainly what they lack."""

import json
import math
import re
import socket
import sqlite3
from base64 import b64decode
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import labbook_toy
import pandas as pd
import pytest
from labbook_web.page import with_units
from labbook_web.pages import runs as runs_page
from labbook_web.pages.curves import caption
from labbook_web.pages.lab import columns_of
from labbook_web.serve import serve
from PIL import Image
from toy_lab import WINDOW, carry_out, labbook, study_file
from toy_web import ORIFICES, REPLICATES, Read, client, everything, keys_of, listing, make, pages, twin_table, twins

from labbook.export.film import film
from labbook.lab import Catalogue, LabFolder, notes, studies
from labbook.lab.catalogue import RUN_COLUMNS
from labbook.lab.notes import Note
from labbook.results.find import find
from labbook.results.frames import frames
from labbook.study import load

STUDY, POINTS = "toy-study", len(ORIFICES)


@pytest.fixture(scope="module")
def asked(done):
    """Who asks for pages of the lab that nobody changes."""
    return client(done / "lab")


@pytest.fixture(scope="module")
def results(done):
    """What the rest of labbook finds in that lab."""
    return find(load(done / "toy.yaml"), Catalogue(done / "lab"), "toy")


@pytest.fixture(scope="module")
def mixed(tmp_path_factory) -> Path:
    """A lab of two studies and two backends, some of whose runs clog and some diverge."""
    folder = tmp_path_factory.mktemp("mixed")
    part = load(study_file(folder, count=200, orifices="[18, 24]", replicates=2))
    carry_out(part, folder / "lab", backend=labbook_toy.Twin())
    path = study_file(folder, count=200, orifices="[8, 18, 24]", replicates=3)
    labbook("run", path, "--lab", folder / "lab", "--backend", "toy", LABBOOK_TOY_FAILS="18", check=False)
    other = folder / "other.yaml"
    other.write_text(path.read_text().replace(STUDY, "other").replace("[8, 18, 24]", "[36]"))
    labbook("run", other, "--lab", folder / "lab", "--backend", "toy")
    return folder / "lab"


@pytest.fixture
def at_once(monkeypatch):
    """Results are looked up each time, however quickly one asks."""
    monkeypatch.setattr("labbook_web.store.AGE_FACTOR", 0)


def frame(answer) -> pd.DataFrame:
    """The table of a CSV twin."""
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].startswith("text/csv")
    return twin_table(answer.text)


# every page, in every form


def test_every_page_answers_in_every_form(done, asked):
    shown = pages(done / "lab", STUDY, POINTS)
    assert len(shown) == 4 + POINTS + POINTS * REPLICATES + 4
    for page in shown:
        answer = asked.get(page)
        assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8"), page
        assert answer.text.startswith("<!DOCTYPE html>")
        assert asked.head(page).status_code == 200
        said = asked.get(twins(page, "json"))
        assert said.headers["content-type"] == "application/json"
        json.loads(said.text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
        table = asked.get(twins(page, "csv"))
        assert (table.status_code, table.headers["content-type"]) == (200, "text/csv; charset=utf-8"), page


def test_a_page_names_its_twins(done, asked):
    for page in pages(done / "lab", STUDY, POINTS):
        if "compare?" not in page:
            links = Read(asked.get(page).text).links("href")
            assert {twins(page, "json"), twins(page, "csv")} <= set(links), page


def test_links_of_all_pages_lead_to_pages(done, asked):
    """No link within the app is dead."""
    found = set()
    for page in pages(done / "lab", STUDY, POINTS):
        found |= {one.partition("#")[0] for one in Read(asked.get(page).text).links("href", "src", "hx-get", "action")}
    found.discard("")
    assert any(one.startswith("/run/") for one in found)
    for link in found:
        if link.endswith(("/viewer", ".rrd", "film.webp", "loop.webp")):
            continue  # asks for the viewer, which tests in a browser open, or for a film (below)
        assert asked.get(link).status_code in (200, 301), link


def test_nothing_in_the_lab_changes_by_looking(done):
    """The index is opened by SQLite, which keeps two files of its own beside it: an empty log and what it shares."""
    before = listing(done / "lab")
    somebody = client(done / "lab")
    for address in everything(done / "lab", STUDY, POINTS):
        assert somebody.get(address).status_code == 200, address
    after = listing(done / "lab")
    assert after.pop("catalogue.db-wal", (0,))[0] == 0
    for name in ("catalogue.db-shm", "catalogue.db-wal"):
        before.pop(name, None)
        after.pop(name, None)
    assert after == before


# the page of the lab


def test_the_first_page_has_a_card_for_each_study(mixed):
    somebody = client(mixed)
    page = Read(somebody.get("/").text)
    assert {f"/card/{STUDY}", "/card/other"} <= set(page.links("hx-get"))
    listed = somebody.get("/index.json").json()
    every = Catalogue(mixed).runs()
    assert {one["study"]: one["runs"] for one in listed["studies"]} == every["study"].value_counts().to_dict()
    assert listed["runs"] == every["outcome"].value_counts().to_dict()
    assert listed["packings"] == len(list((mixed / "packings").iterdir()))
    assert listed["running"] == []
    assert sorted(frame(somebody.get("/index.csv"))["study"]) == ["other", STUDY]
    for word, left in (("other", {"other"}), ("TOY", {STUDY}), ("no-such", set())):
        found = somebody.get("/index.json", params={"q": word}).json()["studies"]
        assert {one["study"] for one in found} == left


def test_studies_stand_on_pages(mixed, monkeypatch):
    monkeypatch.setattr("labbook_web.pages.lab.CARDS", 1)
    somebody = client(mixed)
    cards = [Read(somebody.get(f"/?page={number}").text).links("hx-get") for number in (1, 2)]
    assert sorted(cards) == [["/card/other"], [f"/card/{STUDY}"]]
    assert somebody.get("/?page=3").status_code == 404


def test_a_card_tells_how_a_study_stands(asked):
    card = asked.get(f"/card/{STUDY}").text
    assert "Flow through an hourglass" in card
    assert f"{POINTS * REPLICATES} finished" in card
    assert f"{POINTS * REPLICATES} of {POINTS * REPLICATES} runs" in " ".join(card.split())
    assert "Beverloo" in card
    assert re.search(r"Flow rate W <b>[\d.]+ to [\d.]+</b> g/s", card)
    assert card.count("/picture.png") == POINTS
    assert asked.get("/card/none").status_code == 404


# the page of a study


def test_a_study_in_json_is_what_results_found(asked, results):
    told = asked.get(f"/study/{STUDY}.json").json()
    tables = frames(results, ("points", "fits", "series"))
    assert (told["study"], told["backend"]) == (STUDY, "toy")
    for name, table in tables.items():
        shown = pd.DataFrame(told[name])
        assert list(shown.columns) == list(table.columns)
        for column in table:
            ours, theirs = table[column].tolist(), shown[column].tolist()
            for one, other in zip(ours, theirs, strict=True):
                if pd.isna(one) or (isinstance(one, float) and math.isinf(one)):
                    assert pd.isna(other), (name, column)
                elif isinstance(one, float):
                    assert other == pytest.approx(one, rel=1e-13, abs=1e-15), (name, column)
                else:
                    assert other == one, (name, column)


def test_a_study_in_csv_has_a_row_a_point(asked, results):
    answer = asked.get(f"/study/{STUDY}.csv")
    assert {"point", "container.orifice [m]", "flow_rate [kg/s]"} <= {*answer.text.partition("\n")[0].split(",")}
    table = frame(answer)
    assert table["point"].tolist() == [1, 2, 3, 4]
    assert table["container.orifice"].tolist() == [one / 1000 for one in ORIFICES]
    pooled = [one.pooled["flow_rate"] for one in results.points]
    assert table["flow_rate"].tolist() == [one.value for one in pooled]
    assert table["flow_rate_error"].tolist() == [one.error for one in pooled]
    assert table["replicates"].tolist() == [REPLICATES] * POINTS


def test_the_page_of_a_study_shows_every_point(asked, results):
    page = Read(asked.get(f"/study/{STUDY}").text)
    head, *rows = page.rows["points"]
    assert len(rows) == POINTS == len(results.points)
    runs = head.index("n")
    assert [row[runs] for row in rows] == [str(REPLICATES)] * POINTS
    for row, one in zip(rows, results.points, strict=True):
        number = one.point.index + 1
        assert row[1] == str(number)
        assert row[head.index("D [mm]")] == f"{ORIFICES[one.point.index]}"
        assert float(row[head.index("W [g/s]")].split(" ±")[0]) == pytest.approx(
            1e3 * one.pooled["flow_rate"].value, rel=5e-3
        )
        assert f"/study/{STUDY}/point/{number}" in page.links("href")
    drawn = page.data
    assert [one["n"] for one in drawn["points"]] == [1, 2, 3, 4]
    for one, result in zip(drawn["points"], results.points, strict=True):
        pooled = result.pooled["flow_rate"]
        assert one["values"]["flow_rate"] == [pooled.value, pooled.error, pooled.low, pooled.high, pooled.n]
    (series,) = drawn["series"]
    assert list(series["laws"]) == ["beverloo", "janda"]
    fit = results.series[0].fits["beverloo"]
    law = series["laws"]["beverloo"]
    assert law["residuals"] == pytest.approx([100 * math.expm1(one) for one in fit.residuals])
    expected = [
        100 * one.flow_rate.half_width / W for one, W in zip(results.points, fit.predict(fit.D)[0], strict=True)
    ]
    assert law["half_widths"] == pytest.approx(expected), "each point's own 95 % interval, as in the report"
    assert len(set(law["half_widths"])) == POINTS


def test_the_page_of_a_point_has_its_runs(asked, results):
    for one in results.points:
        address = f"/study/{STUDY}/point/{one.point.index + 1}"
        page = Read(asked.get(address).text)
        keys = [run.run_key for run in one.runs]
        assert {f"/run/{key[:16]}" for key in keys} <= set(page.links("href"))
        assert [curve["run"] for curve in page.data["curves"]] == keys
        for curve, run in zip(page.data["curves"], one.runs, strict=True):
            assert curve["rate"] == pytest.approx(list(run.trace.rate))
        every = frames(results, ("runs",))["runs"]
        mine = every.loc[every["point"] == one.point.index + 1, :]
        assert len(mine) >= REPLICATES
        assert asked.get(f"{address}.csv").text == with_units(mine).to_csv(index=False)
        told = asked.get(f"{address}.json").json()
        assert {row["run_key"] for row in told["runs"]} == set(keys)
        assert f"{REPLICATES} of {REPLICATES} runs" in page.words


def test_the_page_of_a_run_has_its_numbers(done, asked):
    catalogue = Catalogue(done / "lab")
    for key in keys_of(done / "lab"):
        stored = json.loads((done / "lab/runs" / key / "run.json").read_text())
        told = asked.get(f"/run/{key[:16]}.json").json()
        assert told["run"]["coverage"] == stored["coverage"]
        table = frame(asked.get(f"/run/{key[:16]}.csv"))
        expected = catalogue.measurements(key)
        assert table["quantity"].tolist() == expected["quantity"].tolist()
        assert table["value"].tolist() == expected["value"].tolist()
        page = Read(asked.get(f"/run/{key[:16]}").text)
        assert key[:16] in page.words
        assert ("a frame every 5 ms" in page.words) == (stored["seed"] == 1)
        assert f"/study/{STUDY}/point/{stored['point'] + 1}" in page.links("href")
        assert f"/run/{key[:16]}/file/crossing.npz" in page.links("href")


def test_files_of_a_run_are_handed_out_as_they_are(done, asked):
    key = keys_of(done / "lab")[0]
    folder = done / "lab/runs" / key
    for path in folder.iterdir():
        answer = asked.get(f"/run/{key[:16]}/file/{path.name}")
        if path.name.startswith("measured-"):
            assert answer.status_code == 404, "what is evaluated can be had as JSON and CSV"
            continue
        assert answer.content == path.read_bytes()
        assert answer.headers["content-disposition"].startswith("attachment")
    assert asked.get(f"/run/{key[:16]}/picture.png").content == (folder / "picture.png").read_bytes()
    text = asked.get(f"/study/{STUDY}/{STUDY}.yaml")
    assert text.text == (done / "toy.yaml").read_text()


def test_a_film_is_made_when_it_is_asked_for_and_kept(copied, tmp_path, monkeypatch):
    monkeypatch.setenv("LABBOOK_CACHE", str(tmp_path))
    monkeypatch.setattr("labbook.export.film.film", partial(film, seconds=0.1, size=40))
    recorded = {path.parent.name for path in (copied / "lab").glob("runs/*/recording.npz")}
    key, other = min(recorded), min(set(keys_of(copied / "lab")) - recorded)
    app = client(copied / "lab")
    assert f'loading="lazy" src="/run/{key[:16]}/film.webp"' in app.get(f"/run/{key[:16]}").text
    first = app.get(f"/run/{key[:16]}/film.webp")
    assert first.headers["content-type"] == "image/webp"
    assert first.content[8:12] == b"WEBP"
    (path,) = (tmp_path / "web/films").iterdir()
    path.write_bytes(first.content + b"kept")
    assert app.get(f"/run/{key[:16]}/film.webp").content == first.content + b"kept"
    assert app.get(f"/run/{other[:16]}/film.webp").status_code == 404
    assert "film.webp" not in app.get(f"/run/{other[:16]}").text


def test_beds_of_a_card_that_were_recorded_have_loops(copied, tmp_path, monkeypatch):
    monkeypatch.setenv("LABBOOK_CACHE", str(tmp_path))
    recorded = {path.parent.name[:16] for path in (copied / "lab").glob("runs/*/recording.npz")}
    app = client(copied / "lab")
    card = app.get(f"/card/{STUDY}").text
    beds = re.findall(r'<img src="/run/(\w+)/picture.png"[^>]*?(data-loop="[^"]*")?>', card)
    assert {key for key, loop in beds if loop} == {key for key, _ in beds} & recorded != set()
    key = min(key for key, loop in beds if loop)
    answer = app.get(f"/run/{key}/loop.webp")
    assert answer.headers["content-type"] == "image/webp"
    assert Image.open(BytesIO(answer.content)).info["loop"] == 0
    assert [path.read_bytes() for path in (tmp_path / "web/loops").iterdir()] == [answer.content]
    other = next(key for key in keys_of(copied / "lab") if key[:16] not in recorded)
    assert app.get(f"/run/{other[:16]}/loop.webp").status_code == 404


@pytest.mark.parametrize(
    ("beds", "shape", "columns"), [(6, 0.3, 6), (6, 1.0, 3), (6, 3.0, 2), (1, 1.0, 1), (2, 0.5, 2)]
)
def test_beds_of_a_card_are_as_large_as_they_can_be(beds, shape, columns):
    """Upright ones in a row, wide ones below one another."""
    assert columns_of(beds, shape) == columns


def test_a_study_without_runs_is_drawn_on_its_card(tmp_path):
    path = study_file(tmp_path)
    app = client(tmp_path / "lab", [path])
    (address,) = re.findall(r'<div class="beds sketch"[^>]*><img src="([^"]*)"', app.get(f"/card/{STUDY}").text)
    kind, _, content = address.partition(";base64,")
    assert kind == "data:image/svg+xml"
    assert b64decode(content).startswith(b"<svg")
    assert "What is simulated" in app.get(f"/study/{STUDY}").text


def test_a_run_without_a_picture_is_sketched(copied):
    key = keys_of(copied / "lab")[0]
    (copied / "lab/runs" / key / "picture.png").unlink()
    answer = client(copied / "lab").get(f"/run/{key[:16]}/picture.png")
    assert answer.headers["content-type"] == "image/svg+xml"
    assert answer.text.startswith("<svg")


def test_figures_are_drawn_when_they_are_seen(tmp_path):
    path = study_file(tmp_path, count=400, orifices="[24, 30]", replicates=2)
    path.write_text(path.read_text().replace("sweep:\n", 'sweep:\n  container.angle: "[60, 90] deg"\n'))
    labbook("run", path, "--lab", tmp_path / "lab", "--backend", "toy")
    somebody = client(tmp_path / "lab")
    addresses = Read(somebody.get(f"/study/{STUDY}").text).links("hx-get")
    (address,) = (one for one in addresses if "against-container-angle" in one)
    part = Read(somebody.get(address).text)
    (image,) = part.links("src")
    drawn = somebody.get(image)
    assert drawn.headers["content-type"] == "image/svg+xml"
    assert b"<svg" in drawn.content
    assert "Above: W with 95 % intervals." in part.words, "the caption of the report"
    files = {one.partition("?")[0].rpartition(".")[2]: one for one in part.links("href")}
    assert files.keys() == {"svg", "png", "pdf", "csv"}
    assert somebody.get(files["pdf"]).content.startswith(b"%PDF")
    assert somebody.get(files["png"]).content.startswith(b"\x89PNG")
    head = somebody.get(files["csv"]).text.partition("\n")[0].split(",")
    assert {"container.angle [rad]", "container.orifice [m]"} <= {*head}
    assert somebody.get(f"/study/{STUDY}/figure/none").status_code == 404
    assert somebody.get(f"/study/{STUDY}/figure/none.svg").status_code == 404


def test_a_figure_that_cannot_be_drawn_says_what_to_do(asked):
    """Flow patterns of recordings are evaluated by a report, and by nobody who looks."""
    (address,) = (one for one in Read(asked.get(f"/study/{STUDY}").text).links("hx-get") if "/patterns" in one)
    part = asked.get(address)
    assert part.status_code == 200
    assert "labbook report toy-study.yaml" in part.text
    assert "<img" not in part.text


def test_keys_are_known_by_their_beginning(done, asked):
    keys = keys_of(done / "lab")
    for key in keys:
        length = next(n for n in range(4, 25) if sum(one.startswith(key[:n]) for one in keys) == 1)
        assert asked.get(f"/run/{key[:length]}.json").json()["run"]["run_key"] == key
        assert asked.get(f"/run/{key}").status_code == 200
    assert asked.get("/run/abc").status_code == 400
    lone = next(one for one in ("0000", "ffff", "1234") if not any(key.startswith(one) for key in keys))
    assert asked.get(f"/run/{lone}").status_code == 404


def test_a_beginning_that_several_keys_have_names_them(done, monkeypatch):
    keys = keys_of(done / "lab")[:2]
    monkeypatch.setattr(Catalogue, "matching", lambda self, prefix: keys)
    answer = client(done / "lab").get("/run/abcd")
    assert answer.status_code == 404
    assert all(key[:12] in answer.text for key in keys)


def test_static_files_come_once(asked):
    first = asked.get("/static/labbook.css")
    assert (first.status_code, first.headers["content-type"]) == (200, "text/css; charset=utf-8")
    assert asked.get("/static/labbook.css", headers={"if-none-match": first.headers["etag"]}).status_code == 304


# labs that lack something


@pytest.fixture(scope="module")
def few(tmp_path_factory) -> Path:
    """A lab with a study of so few grains that no run has a window."""
    folder = tmp_path_factory.mktemp("few")
    make(folder, count=100, orifices="[18, 24]", replicates=2)
    return folder / "lab"


TOO_FEW = r"too few grains: \d+ of 100 left, fewer than 60 in the window"


def test_a_study_whose_runs_gave_no_number_says_why(few):
    somebody = client(few)
    page = Read(somebody.get(f"/study/{STUDY}").text)
    why = page.data["nothing"]
    assert re.fullmatch("No flow rate at .*: fewer than 60 grains flowed out .* more grains or a wider window.*", why)
    assert page.words.count(why) == 3, "in a tile, in the result in words and in place of the chart"
    assert "chart" not in [given.get("id") for _, given in page.elements]
    assert why in somebody.get(f"/card/{STUDY}").text
    assert "No run gave a number" in somebody.get(f"/study/{STUDY}/point/1").text


def test_nothing_is_said_to_be_drawn_that_is_not(few, done):
    drawn, somebody = client(done / "lab"), client(few)
    runs = [f"/run/{key[:16]}" for key in keys_of(few)[:2]]
    for address in (*runs, f"/study/{STUDY}/point/1", f"/compare?item=run:{runs[0][5:]}&item=run:{runs[1][5:]}"):
        said = somebody.get(address).text
        assert "haded:" not in said
        assert "otted:" not in said
        assert re.search(TOO_FEW, said)
    assert re.search(f"No window and no mean: {TOO_FEW}\\.", somebody.get(runs[0]).text)
    assert (
        "Shaded: the window in which the flow counts as steady; dotted: the mean over it."
        in drawn.get(f"/run/{keys_of(done / 'lab')[0][:16]}").text
    )
    assert (
        "Dotted: the mean over the window in which the flow counts as steady. Hover"
        in drawn.get(f"/study/{STUDY}/point/1").text
    )


@pytest.mark.parametrize(
    ("curves", "said"),
    [
        ([("window", None)], "Shaded: the window in which the flow counts as steady."),
        ([(None, None)], "No window and no mean: few."),
        ([("window", [1, 0.1]), (None, None)], "Dotted: the mean over the window in which the flow counts as steady, "
                                               "of 1 of 2 runs. Hover over a curve to see its name."),
        ([("window", None), ("window", None)], "No mean: few. Hover over a curve to see its name."),
    ],
)  # fmt: skip
def test_captions_name_what_is_drawn(curves, said):
    assert caption([{"window": window, "mean": mean, "why": "" if mean else "few"} for window, mean in curves]) == said


def test_the_address_can_be_reached_as_soon_as_it_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("uvicorn.Server.run", lambda *_, **__: None)
    monkeypatch.setattr("os.nice", lambda _: 0)
    reached = []

    def say(line: str) -> None:
        host, port = re.findall(r"http://([\d.]+):(\d+)/", line)[0]
        with socket.create_connection((host, int(port)), timeout=5):
            reached.append(port)

    serve(tmp_path, port=0, say=say)
    assert reached


@pytest.mark.parametrize("there", [False, True])
def test_a_lab_that_is_not_there_is_not_served(tmp_path, there):
    lab = tmp_path / "typo"
    if there:
        lab.mkdir()
    ended = labbook("web", "--no-open", "--lab", lab, check=False)
    assert ended.exit_code == 1
    assert str(lab) in ended.output
    assert "is not a lab" in ended.output if there else "there is no lab" in ended.output
    assert lab.exists() == there


def test_an_empty_or_missing_lab_says_how_to_begin(tmp_path):
    (tmp_path / "empty").mkdir()
    for lab in (tmp_path / "empty", tmp_path / "missing"):
        somebody = client(lab)
        page = somebody.get("/")
        assert page.status_code == 200
        assert "labbook run first.yaml" in page.text
        assert somebody.get("/index.json").json()["studies"] == []
        assert somebody.get("/runs.json").json()["total"] == 0
        for address in ("/runs", "/compare", "/index.csv", "/runs.csv"):
            assert somebody.get(address).status_code == 200
        assert somebody.get(f"/study/{STUDY}").status_code == 404
    assert not (tmp_path / "missing").exists()
    assert not list((tmp_path / "empty").iterdir())


def test_a_study_without_runs_is_shown(tmp_path):
    path = study_file(tmp_path)
    somebody = client(tmp_path / "lab", [path])
    assert "No finished run yet" in somebody.get(f"/card/{STUDY}").text
    page = somebody.get(f"/study/{STUDY}")
    assert page.status_code == 200
    assert f"labbook run {path}" in page.text
    assert somebody.get(f"/study/{STUDY}/point/1").status_code == 404
    assert "0 of 4 runs" in " ".join(Read(page.text).words.split())


def test_a_lab_of_another_schema_says_so_on_every_page(copied):
    with sqlite3.connect(copied / "lab/catalogue.db") as index:
        index.execute("UPDATE about SET schema_version = schema_version - 1")
    somebody = client(copied / "lab")
    for address in ("/", "/runs", f"/study/{STUDY}", "/compare?item=study:" + STUDY, f"/card/{STUDY}"):
        answer = somebody.get(address)
        assert answer.status_code == 503, address
        assert "labbook reindex" in answer.text
    assert "labbook reindex" in somebody.get("/runs.json").json()["error"]
    labbook("reindex", "--lab", copied / "lab")
    assert somebody.get("/runs").status_code == 200, "the app need not be started again"


@pytest.mark.parametrize("damage", ["truncated", "missing"])
def test_a_run_that_cannot_be_read_is_one_red_row(copied, damage):
    lab = copied / "lab"
    victim = keys_of(lab)[0]
    record = lab / "runs" / victim / "run.json"
    if damage == "missing":
        record.unlink()
    else:
        record.write_bytes(record.read_bytes()[:100])
    labbook("reindex", "--lab", lab, check=False)
    somebody = client(lab)
    runs = somebody.get("/runs").text
    assert runs.count('<tr class="red">') == 1
    assert f"/run/{victim[:16]}" in Read(runs).links("href")
    page = somebody.get(f"/run/{victim[:16]}")
    assert page.status_code == 200
    assert "cannot be read" in page.text
    for ending in ("json", "csv"):
        assert somebody.get(f"/run/{victim[:16]}.{ending}").status_code == 200
    for address in everything(lab, STUDY, POINTS):
        known = 404 if f"run:{victim[:16]}" in address else 200
        assert somebody.get(address).status_code == known, address
    others = sum(one["runs"] for one in somebody.get("/index.json").json()["studies"] if one["study"] == STUDY)
    assert others >= POINTS * REPLICATES - 1


def test_a_run_that_changed_since_it_was_indexed_is_marked(copied):
    lab = copied / "lab"
    key = keys_of(lab)[0]
    (lab / "runs" / key / "crossing.npz").write_bytes(b"garbage")
    page = client(lab).get(f"/run/{key[:16]}")
    assert page.status_code == 200
    assert "changed since it was indexed" in page.text


def test_a_study_file_that_is_broken_is_one_red_card(mixed, tmp_path, done):
    lab = tmp_path / "lab"
    for one in ("toy-study", "other"):
        text = (
            studies.study_path(LabFolder(mixed), one).read_text() if one == "other" else "name: toy-study\ngrains: [\n"
        )
        studies.keep(LabFolder(lab), one, text)
    somebody = client(lab)
    assert somebody.get("/").status_code == 200
    wrong = somebody.get(f"/card/{STUDY}")
    assert wrong.status_code == 200
    assert 'class="card broken"' in wrong.text
    assert "toy-study.yaml" in wrong.text
    right = somebody.get("/card/other")
    assert "broken" not in right.text
    assert "No finished run yet" in right.text
    for address in (f"/study/{STUDY}", f"/study/{STUDY}.json", f"/progress/{STUDY}", f"/compare?item=study:{STUDY}"):
        assert somebody.get(address).status_code == 422, address


def test_a_given_file_that_is_broken_is_one_red_card(done, tmp_path):
    (tmp_path / "wrong.yaml").write_text("name: [")
    somebody = client(done / "lab", [tmp_path / "wrong.yaml"])
    assert 'class="card broken"' in somebody.get("/card/wrong").text
    assert "broken" not in somebody.get(f"/card/{STUDY}").text


def test_runs_without_the_file_of_their_study_are_told(copied):
    studies.study_path(LabFolder(copied / "lab"), STUDY).unlink()
    somebody = client(copied / "lab")
    card = somebody.get(f"/card/{STUDY}").text
    assert f"labbook web {STUDY}.yaml" in card
    assert somebody.get(f"/study/{STUDY}").status_code == 404
    key = keys_of(copied / "lab")[0]
    assert somebody.get(f"/run/{key[:16]}").status_code == 200
    again = client(copied / "lab", [copied / "toy.yaml"])
    assert again.get(f"/study/{STUDY}").status_code == 200


def test_what_is_not_evaluated_is_said_and_stays_so(tmp_path, monkeypatch):
    """Another window than that of the runs: somebody who looks must not evaluate all runs."""
    make(tmp_path, orifices="[18, 24]", replicates=2, measure="flow_rate, outlet_profiles, packing")
    lab = tmp_path / "lab"
    kept = studies.study_path(LabFolder(lab), STUDY)
    kept.write_text(kept.read_text().replace(WINDOW, "window: {start: 0.2, end: 0.5}"))
    monkeypatch.setattr("labbook.lab.evaluations.evaluate", lambda *_: pytest.fail("somebody who looked evaluated"))
    before = listing(lab)
    somebody = client(lab)
    for address in everything(lab, STUDY, 2):
        assert somebody.get(address).status_code == 200, address
    page = somebody.get(f"/study/{STUDY}").text
    assert "4 runs not evaluated yet" in page
    assert "labbook fit toy-study.yaml" in page
    assert "labbook fit toy-study.yaml" in somebody.get(f"/study/{STUDY}/point/1").text
    assert "not evaluated" in somebody.get(f"/card/{STUDY}").text
    after = listing(lab)
    for one in (before, after):
        for name in ("catalogue.db-wal", "catalogue.db-shm"):
            one.pop(name, None)
    assert after == before


# lists of runs


SELECTIONS = [
    {},
    {"study": STUDY},
    {"backend": "twin"},
    {"outcome": "clogged"},
    {"outcome": "diverged"},
    {"study": STUDY, "backend": "toy", "outcome": "finished"},
    {"q": "24 mm"},
    {"q": "OTHER"},
    {"q": "%"},
    {"q": "_"},
    {"study": "none"},
]


@pytest.mark.parametrize("wanted", SELECTIONS, ids=lambda one: ",".join(map("=".join, one.items())) or "all")
def test_filters_leave_what_pandas_leaves(mixed, wanted):
    every: Any = Catalogue(mixed).runs()
    for name, value in wanted.items():
        if name == "q":
            label, study = (every[one].str.contains(value, case=False, regex=False) for one in ("label", "study"))
            every = every[label | study | every["run_key"].str.startswith(value)]
        else:
            every = every[every[name] == value]
    somebody = client(mixed)
    told = somebody.get("/runs.json", params=wanted).json()
    assert told["total"] == len(every)
    assert {row["run_key"] for row in told["runs"]} == set(every["run_key"])
    table = frame(somebody.get("/runs.csv", params=wanted)) if len(every) else pd.DataFrame({"run_key": []})
    assert set(table["run_key"]) == set(every["run_key"])
    page = Read(somebody.get("/runs", params=wanted).text)
    assert sum(one.startswith("/run/") for one in page.links("href")) == len(every)
    assert f"{len(every)} run" in page.words


def test_every_kind_of_end_is_in_that_lab(mixed):
    """So that filters above have something to leave out."""
    assert set(Catalogue(mixed).runs()["outcome"]) == {"finished", "clogged", "diverged"}


@pytest.mark.parametrize("column", [name for name in RUN_COLUMNS if name != "problem"])
def test_runs_are_sorted_as_pandas_sorts(mixed, column):
    every = Catalogue(mixed).runs().sort_values("run_key")
    somebody = client(mixed)
    for sign in ("", "-"):
        expected = every.sort_values(column, ascending=not sign, kind="stable")
        shown = somebody.get("/runs.json", params={"sort": sign + column}).json()["runs"]
        assert [row["run_key"] for row in shown] == expected["run_key"].tolist(), sign + column


def test_long_lists_are_cut_into_pages(mixed, monkeypatch):
    monkeypatch.setattr(runs_page, "PAGE_SIZE", 4)
    somebody = client(mixed)
    every = Catalogue(mixed).runs().sort_values("run_key")["run_key"].tolist()
    pages_of = -(-len(every) // 4)
    shown = []
    for number in range(1, pages_of + 1):
        told = somebody.get("/runs.json", params={"sort": "run_key", "page": number}).json()
        assert (told["total"], told["pages"]) == (len(every), pages_of)
        shown += [row["run_key"] for row in told["runs"]]
    assert shown == every
    assert somebody.get("/runs", params={"page": pages_of + 1}).status_code == 404
    first, last = (Read(somebody.get("/runs", params={"page": n}).text).words for n in (1, pages_of))
    assert ("Next" in first, "Previous" in first) == (True, False)
    assert ("Next" in last, "Previous" in last) == (False, True)
    table = frame(somebody.get("/runs.csv", params={"sort": "run_key"}))
    assert table["run_key"].tolist() == every, "a table that is downloaded is whole"


def test_runs_of_a_packing_and_of_a_tag(copied):
    lab = copied / "lab"
    table = frame(client(lab).get("/runs.csv"))
    packing, mine = next(iter(table.groupby("packing_key")))
    told = client(lab).get("/runs.json", params={"packing": str(packing)}).json()
    assert {row["run_key"] for row in told["runs"]} == set(mine["run_key"])
    key = mine["run_key"].iloc[0]
    notes.write(LabFolder(lab), "run", key, Note("", ("odd",)))
    told = client(lab).get("/runs.json", params={"tag": "odd"}).json()
    assert [row["run_key"] for row in told["runs"]] == [key]
    assert client(lab).get("/runs.json", params={"tag": "none"}).json()["runs"] == []


# states, backends, comparisons


@pytest.mark.usefixtures("at_once")
def test_a_permalink_warns_when_the_results_have_changed(copied):
    lab = copied / "lab"
    somebody = client(lab)
    state = somebody.get(f"/study/{STUDY}.json").json()["state"]
    link = f"/study/{STUDY}?as={state}"
    (link,) = (one for one in Read(somebody.get(f"/study/{STUDY}").text).links("href") if one.startswith(link))
    assert "Changes since" not in somebody.get(link).text
    assert "have changed" not in somebody.get(link).text
    assert client(lab).get(f"/study/{STUDY}.json").json()["state"] == state, "another process finds the same"
    text = (copied / "toy.yaml").read_text()
    (copied / "toy.yaml").write_text(text.replace("replicates: 3", f"replicates: {REPLICATES + 1}", 1))
    labbook("run", copied / "toy.yaml", "--lab", lab, "--backend", "toy")
    changed = somebody.get(link).text
    assert "have changed" in changed
    assert state in changed
    assert somebody.get(f"/study/{STUDY}.json").json()["state"] != state
    assert len(somebody.get(f"/study/{STUDY}/point/1.json").json()["runs"]) > REPLICATES


def test_of_two_backends_the_one_with_most_runs_is_shown(mixed):
    somebody = client(mixed)
    kept = studies.study_path(LabFolder(mixed), STUDY)
    assert "[8, 18, 24]" in kept.read_text()
    assert somebody.get(f"/study/{STUDY}.json").json()["backend"] == "toy"
    twin = somebody.get(f"/study/{STUDY}.json", params={"backend": "twin"}).json()
    assert twin["backend"] == "twin"
    expected = frames(find(load(kept), Catalogue(mixed), "twin"), ("points",))["points"]
    assert [row["value"] for row in twin["points"]] == pytest.approx(expected["value"].tolist(), rel=1e-13)
    page = Read(somebody.get(f"/study/{STUDY}").text)
    assert f"/study/{STUDY}?backend=twin" in page.links("href")
    (link,) = (one for one in page.links("href") if one.startswith("/compare?"))
    assert somebody.get(link).status_code == 200
    assert somebody.get(f"/study/{STUDY}", params={"backend": "none"}).status_code == 404


def test_points_are_compared_with_ratios(asked, results):
    first, other = (one.pooled["flow_rate"] for one in (results.points[0], results.points[3]))
    items = [("item", f"point:{STUDY}:1"), ("item", f"point:{STUDY}:4")]
    told = asked.get("/compare.json", params=items).json()
    assert told["differences"] == [["container.orifice", ["18 mm", "30 mm"]]]
    (row,) = (one for one in told["numbers"] if one["name"].startswith("W"))
    assert [float(value.split(" ±")[0]) for value in row["values"]] == pytest.approx(
        [1e3 * first.value, 1e3 * other.value], rel=5e-3
    )
    assert float(row["ratios"][0].split(" ±")[0]) == pytest.approx(other.value / first.value, rel=5e-3)


def test_what_cannot_be_compared_is_refused(asked):
    many = [("item", f"point:{STUDY}:{k % POINTS + 1}@{name}") for k in range(POINTS) for name in ("toy", "twin")]
    assert asked.get("/compare", params=many).status_code == 400
    for item in ("", "x", "run:z/", f"study:{STUDY}:1", f"point:{STUDY}", "run:../..", "point:a b:1"):
        answer = asked.get("/compare", params=[("item", item)])
        assert answer.status_code == (200 if item == "" else 400), item
    for item in ("study:none", "point:none:1", f"point:{STUDY}:99", "run:ffffffff", f"study:{STUDY}@none"):
        assert asked.get("/compare", params=[("item", item)]).status_code == 404, item


@pytest.mark.slow
def test_compared_backends_are_known_to_the_pages(tmp_path):
    """Runs that start from the other backend's packings count; the verdict, its figure and its recording are shown."""
    path, lab = study_file(tmp_path, count=400, orifices="[24, 30]", replicates=2), tmp_path / "lab"
    labbook("compare", path, "--lab", lab, "--backends", "toy,twin")
    (lab / "compare/toy-study/toy-twin.rrd").write_bytes(b"both side by side")
    asked = client(lab, [path])
    page = asked.get(f"/study/{STUDY}?backend=twin").text
    assert "4 of 4 runs" in page
    assert "These runs start from the packings of toy" in page
    assert "No finished run" not in page
    assert "Backends toy and twin" in page
    assert "equivalent within 3 % in all 4 tests" in page
    assert "Stale" not in page
    figure = asked.get(f"/study/{STUDY}/figure/compare-toy-twin.svg?backend=twin")
    assert figure.status_code == 200
    assert b"<svg" in figure.content
    assert asked.get(f"/study/{STUDY}/compare/toy-twin.rrd").content == b"both side by side"
    assert asked.get(f"/study/{STUDY}/compare/..%2Ftoy-twin.rrd").status_code == 404
    both = asked.get(f"/compare?item=study:{STUDY}@toy&item=study:{STUDY}@twin").text
    assert "equivalent within 3 % in all 4 tests" in both
    assert "only the seeds do" not in both
    numbers = asked.get(f"/compare.json?item=study:{STUDY}@toy&item=study:{STUDY}@twin").json()
    assert numbers["differences"] == [["backend", ["toy", "twin"]]]
    assert [row["name"] for row in numbers["numbers"]] == ["W [g/s] at D = 24 mm", "W [g/s] at D = 30 mm"]
    for row in numbers["numbers"]:
        first, second = (float(value.split(" ±")[0]) for value in row["values"])
        assert float(row["ratios"][0].split(" ±")[0]) == pytest.approx(second / first, rel=5e-3)
        assert "2 pairs" in row["ratios"][0], "of runs from shared packings"
    assert f"/study/{STUDY}/figure/compare-toy-twin?backend=twin" in page
    assert "--backend toy" in asked.get(f"/study/{STUDY}?backend=toy").text
