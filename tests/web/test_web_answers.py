"""The page of a study answers before it lists: tiles, the map of two keys, the contact sheet, and what is folded."""

import re
from html import unescape
from pathlib import Path

import pytest
from labbook_web.pages.changes import changes, latest, moment
from labbook_web.pages.sheet import extremes, sheet
from labbook_web.pages.study import chart_data
from labbook_web.pages.tiles import surface_of, tiles
from toy_web import Read, client

import labbook as package
from labbook.api import Results
from labbook.lab import RunRecord

PLANE = "plane"
ORIFICES, ANGLES, SEEDS = (8, 18, 24, 30), (40, 90), 2  # mm, degrees, as in conftest.py
IDLE = {"running": [], "done": 16, "asked": 16}


@pytest.fixture(scope="module")
def results(plane) -> Results:
    return package.Lab(plane / "lab", backend="toy").results(package.load(plane / "plane.yaml"))


@pytest.fixture(scope="module")
def page(plane) -> str:
    answer = client(plane / "lab").get(f"/study/{PLANE}")
    assert answer.status_code == 200
    return unescape(answer.text)


def means(results: Results) -> dict[int, float]:
    """W [g/s] of every point that has one, by its number."""
    return {one.point.index + 1: 1e3 * one.flow_rate.value for one in results.points if one.flow_rate is not None}


def test_the_tiles_have_range_shares_and_what_limits_the_numbers(results):
    found, known = tiles(results, IDLE, surface_of(results)), means(results)
    assert found.range is not None
    low, high = min(known, key=lambda n: known[n]), max(known, key=lambda n: known[n])
    assert [one.point for one in found.range.ends] == [low, high]
    assert [float(one) for one in found.range.text.split(" to ")] == pytest.approx([known[low], known[high]], rel=5e-3)
    assert all(f"n = {SEEDS}" in one.text for one in found.range.ends)
    assert [one["name"] for one in found.bars] == ["orifice D", "angle", "only together"]
    assert sum(one["influence"].share for one in found.bars) == pytest.approx(1, abs=0.02), "parts of one variance"
    assert any("clogged: D = 8 mm" in text for text in (*found.attention, *found.more_attention))
    assert [(one.clogged, one.runs) for one in found.stops] == [(SEEDS, SEEDS)] * 2
    clogged = {run.run_key for one in results.points for run in one.runs if run.outcome == "clogged"}
    assert {one.run_key for one in found.stops} <= clogged


def test_missing_runs_alarm_only_when_nothing_runs(results, monkeypatch):
    monkeypatch.setattr("labbook.results.points.PointResult.partial", property(lambda self: True))
    still, going = tiles(results, IDLE, surface_of(results)), tiles(results, {**IDLE, "running": [{}], "done": 9}, None)
    assert any("Missing runs" in text for text in still.attention)
    assert not any("Missing runs" in text for text in (*going.attention, *going.more_attention))
    assert going.waiting.startswith("9 of 16 runs")


def test_the_sheet_is_a_map_with_the_mean_on_every_tile(results):
    found, known = sheet(results), means(results)
    assert (found.column_key, found.row_key) == ("D [mm]", "angle [deg]")
    assert found.columns == tuple(map(str, ORIFICES))
    assert found.rows == tuple(map(str, ANGLES))
    tiles_ = [tile for line in found.tiles for tile in line if tile is not None]
    assert {tile.point for tile in tiles_ if tile.value == "clogged"} == {1, 2}
    shown = {tile.point: tile for tile in tiles_ if tile.fraction is not None}
    assert shown.keys() == known.keys()
    for n, tile in shown.items():
        assert float(tile.value) == pytest.approx(known[n], rel=5e-3)
        part = (known[n] - min(known.values())) / (max(known.values()) - min(known.values()))
        assert tile.fraction == pytest.approx(part)


def test_cards_show_the_extremes(results):
    known = means(results)
    chosen = [tile.point for tile in extremes(results, 4)]
    assert chosen == sorted(chosen)
    assert len(chosen) == 4
    assert max(known, key=lambda n: known[n]) in chosen
    assert {1, 2} & {*chosen}, "a point that clogged is the smallest"
    assert [tile.point for tile in extremes(results, 100)] == list(range(1, 9))


def test_the_page_begins_with_tiles_and_contents_lead_to_its_parts(page):
    read = Read(page)
    ids = {given["id"] for _, given in read.elements if "id" in given}
    contents = page[page.index('class="contents"') : page.index("</nav>", page.index('class="contents"'))]
    named = re.findall(r'href="#([^"]+)"', contents)
    assert {"result", "charts", "beds-title", "points-title"} <= {*named}
    assert {*named} <= ids
    assert page.index('id="range-title"') < page.index('id="chart"') < page.index('id="points"')
    folded = [given["id"] for tag, given in read.elements if tag == "details" and "id" in given and "open" not in given]
    assert {"all-points", "simulated"} <= {*folded}


def test_the_page_has_the_map_of_two_keys(page, plane, results):
    shown = Read(page).data["map"]
    assert [one["key"] for one in shown["factors"]] == ["container.orifice", "container.angle"]
    assert {one["n"]: 1e3 * one["value"][0] for one in shown["points"] if one["used"]} == pytest.approx(means(results))
    assert {one["n"] for one in shown["points"] if not one["used"]} == {1, 2}
    assert 'id="map"' in page
    explored = client(plane / "lab").get(f"/study/{PLANE}/explore.json").json()["views"][0]
    assert shown["surface"]["coefficients"] == pytest.approx(explored["surface"]["coefficients"])


def test_one_key_has_no_map(done):
    page = client(done / "lab").get("/study/toy-study").text
    assert 'id="map"' not in page
    assert Read(page).data["map"] is None


# runs, and what is new


def listed(plane: Path, **query: str) -> list[dict]:
    answer = client(plane / "lab").get("/runs.json", params=query)
    assert answer.status_code == 200, answer.text
    return answer.json()["runs"]


def test_runs_have_their_flow_rates_and_sort_by_them(plane, results):
    rows = listed(plane, sort="-flow_rate")
    known = [row["flow_rate"] for row in rows if row["flow_rate"] is not None]
    assert known == sorted(known, reverse=True)
    assert [row["flow_rate"] for row in rows[len(known) :]] == [None] * (len(rows) - len(known)), "unknown ones last"
    measured = {run.run_key: run.measured["flow_rate"].value for one in results.points for run in one.runs
                if run.outcome != "clogged"}  # fmt: skip
    assert {row["run_key"]: row["flow_rate"] for row in rows if row["flow_rate"] is not None} == measured


def test_swept_keys_are_columns_that_sort_as_numbers(plane):
    rows = listed(plane, study=PLANE, sort="at:orifice [mm]")
    assert [row["at:orifice [mm]"] for row in rows] == sorted(SEEDS * len(ANGLES) * list(map(float, ORIFICES)))
    assert {row["at:angle [deg]"] for row in rows} == {*map(float, ANGLES)}
    somebody = client(plane / "lab")
    assert somebody.get("/runs", params={"sort": "at:orifice [mm]"}).status_code == 404, "of several studies"
    page = Read(somebody.get("/runs", params={"study": PLANE}).text)
    (head, *body) = page.rows["table 0"]
    at = next(k for k, text in enumerate(head) if text.startswith("orifice [mm]"))
    assert {row[at] for row in body} == {*map(str, ORIFICES)}


def test_what_is_new_since_a_moment_is_told_with_the_means_before(plane, results):
    ended = sorted((run.ended, one.point.index, run.run_key) for one in results.points for run in one.runs)
    since = moment(ended[9][0])
    new = {key for when, _, key in ended if moment(when) > since}
    found = changes(results, since)
    assert 0 < found.new_runs == len(new)
    for row in found.rows:
        runs = results.points[row.point - 1].runs
        before = [run for run in runs if run.run_key not in new and run.outcome != "clogged"]
        assert row.new_runs == sum(run.run_key in new for run in runs)
        assert row.before.endswith(f"n = {len(before)}") if before else row.before == "–"
    assert changes(results, moment(ended[-1][0])).rows == ()
    somebody = client(plane / "lab")
    page = unescape(somebody.get(f"/study/{PLANE}", params={"as": "0", "since": since}).text)
    assert f"{found.new_runs} new run" in page
    assert f"since={latest(results)}".replace(":", "%3A") in page, "the permalink names the moment"
    assert {row["run_key"] for row in listed(plane, since=since)} >= new
    assert somebody.get("/runs?since=yesterday").status_code == 400


@pytest.mark.parametrize(
    ("text", "utc"),
    [
        ("2026-11-20", "2026-11-20T00:00:00"),
        ("2026-11-20T08:30:00+02:00", "2026-11-20T06:30:00"),
        ("2026-11-20T06:30:00.25+00:00", "2026-11-20T06:30:00.250000"),
    ],
)
def test_moments_are_those_of_the_index(text, utc):
    assert moment(text) == utc


# a point, and a run that clogged


def test_a_point_has_its_pooled_mean_and_the_window_on_its_curves(plane, results):
    result = results.points[2]
    page = Read(client(plane / "lab").get(f"/study/{PLANE}/point/3").text)
    pooled = page.data["pooled"]
    assert pooled["mean"] == pytest.approx([result.flow_rate.value, result.flow_rate.low, result.flow_rate.high])
    windows = [run.trace.window for run in result.runs]
    assert pooled["window"] == pytest.approx([sum(ends) / SEEDS for ends in zip(*windows, strict=True)])
    assert re.search(rf"Pooled mean: [\d.]+ \([\d.]+ to [\d.]+, 95 %\) g/s, n = {SEEDS}", page.words)
    assert Read(client(plane / "lab").get(f"/study/{PLANE}/point/1").text).data["pooled"] is None


def test_a_clogged_run_says_why_and_what_flows(plane, results):
    run = results.points[0].runs[0]
    assert run.outcome == "clogged"
    somebody = client(plane / "lab")
    page = somebody.get(f"/run/{run.run_key[:16]}").text
    why = " ".join(re.sub("<[^>]+>", " ", page[page.index('id="why"') : page.index('class="two"')]).split())
    record = RunRecord.read(plane / "lab/runs" / run.run_key)
    assert f"after {record.coverage.crossed} of 300 grains" in why
    assert "D = 8 mm = 2.67 grain diameters" in why, "8 mm over spheres of 3 mm"
    assert f"{SEEDS} of {SEEDS} runs clogged" in why
    assert re.search(rf"D = 18 mm = 6 grain diameters: W = [\d.]+ .* g/s, n = {SEEDS}", why)
    assert f'href="/study/{PLANE}/point/3"' in page
    assert "not measured: add arch to measure" in why
    assert f"/run/{run.run_key[:16]}#why" in somebody.get(f"/study/{PLANE}/point/1").text
    flowed = results.points[2].runs[0]
    assert 'id="why"' not in somebody.get(f"/run/{flowed.run_key[:16]}").text


def test_headings_have_the_meaning_of_their_quantity(page):
    assert '<button type="button" title="mass flow rate in the window">W [g/s]</button>' in page
    assert Read(page).data["quantities"]["flow_rate"]["meaning"] == "mass flow rate in the window"


def test_laws_are_drawn_when_all_runs_are_there(done):
    results = package.Lab(done / "lab", backend="toy").results(package.load(done / "toy.yaml"))
    assert chart_data(results)["series"]
    assert chart_data(results, lacking=True)["series"] == []
