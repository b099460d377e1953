"""The page of a study answers before it lists: tiles, the map of two keys, the contact sheet, and what is folded."""

import re
from html import unescape

import pytest
from labbook_web.pages.sheet import extremes, sheet
from labbook_web.pages.tiles import tiles
from toy_web import Read, client

import labbook as package
from labbook.api import Results

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
    found, known = tiles(results, IDLE), means(results)
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
    still, going = tiles(results, IDLE), tiles(results, {**IDLE, "running": [{}], "done": 9})
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
    shown = {tile.point: tile for tile in tiles_ if tile.part is not None}
    assert shown.keys() == known.keys()
    for n, tile in shown.items():
        assert float(tile.value) == pytest.approx(known[n], rel=5e-3)
        part = (known[n] - min(known.values())) / (max(known.values()) - min(known.values()))
        assert tile.part == pytest.approx(part)


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
