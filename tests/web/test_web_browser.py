"""The web app in a real browser: what is drawn, chosen, followed while a study runs, and usable by everybody."""

import io
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from toy_explore import ANSWERS, compare, questions
from toy_lab import labbook, start, study_file
from toy_web import ORIFICES, client, keys_of, make, serving, twin_table

from labbook import Lab, load
from labbook.api import Results
from labbook.export.film import film, shot_of_run, source_of_film
from labbook.export.recording import path_of
from labbook.lab import LabFolder, RunRecord, notes

CHROMIUM = Path("/usr/bin/chromium")
try:
    from playwright.sync_api import Browser, Locator, Page, ViewportSize, expect, sync_playwright
except ModuleNotFoundError:
    pytest.skip("playwright is not installed: pip install 'labbook[dev]'", allow_module_level=True)
if not CHROMIUM.exists():
    pytest.skip("Chromium is not installed (Debian: apt-get install chromium)", allow_module_level=True)

pytestmark = pytest.mark.browser
ROOT = Path(__file__).parents[2]
STUDY, PLANE, POINTS = "toy-study", "plane", len(ORIFICES)
AXE = (Path(__file__).parent / "vendor/axe-4.14.1.min.js").read_text(encoding="utf-8")
ARGUMENTS = [
    "--no-sandbox", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
DESKTOP, PHONE = ViewportSize(width=1360, height=900), ViewportSize(width=390, height=844)
MS = 1000
expect.set_options(timeout=15 * MS)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """Debian's Chromium, without a window."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def lab(tmp_path_factory) -> Path:
    """A lab with a study of orifices, to which laws are fitted, and one of orifices and angles, some of whose runs
    clog."""
    folder = tmp_path_factory.mktemp("browser")
    first = make(folder, "about: Flow through an hourglass")
    plane = folder / "plane.yaml"
    text = first.read_text().replace(STUDY, PLANE).replace("fit: [beverloo, janda]\n", "")
    swept = '  container.orifice: "[8, 24, 30] mm"\n  container.angle: "[60, 90] deg"\n'
    text = re.sub(r"  container\.orifice: .*\n", swept, text).replace("replicates: 3", "replicates: 2", 1)
    plane.write_text(text)
    labbook("run", plane, "--lab", folder / "lab", "--backend", "toy", check=False)
    notes.write(
        LabFolder(folder / "lab"), "study", PLANE, notes.Note("A note of two\nlines.", ("clogs", "for-the-paper"))
    )
    return folder / "lab"


@pytest.fixture(scope="module")
def base(lab) -> Iterator[str]:
    """Address of a server of that lab."""
    with serving(lab) as address:
        yield address


@contextmanager
def opened(chromium: Browser, base: str, *, dark: bool = False, phone: bool = False) -> Iterator[Page]:
    """A page of a new profile; at the end no script has failed, and no other machine was asked for anything."""
    context = chromium.new_context(
        base_url=base, color_scheme="dark" if dark else "light", viewport=PHONE if phone else DESKTOP
    )
    page, wrong = context.new_page(), []
    page.on("console", lambda said: wrong.append(f"{said.type}: {said.text}") if said.type == "error" else None)
    page.on("pageerror", lambda error: wrong.append(f"error: {error}"))
    context.on("request", lambda one: wrong.append(one.url) if not one.url.startswith((f"{base}/", "data:")) else None)
    yield page
    context.close()
    assert wrong == []


@pytest.fixture
def page(chromium, base) -> Iterator[Page]:
    with opened(chromium, base) as page:
        yield page


def address(page: Page) -> str:
    """Path and query."""
    return re.sub(r"^https?://[^/]+", "", page.url)


def column(page: Page, heading: str) -> list[str]:
    """The cells of a column of the table of points, of the rows that are shown."""
    heads = [one.strip() for one in page.locator("#points thead th").all_inner_texts()]
    (at,) = (k for k, one in enumerate(heads) if one.rstrip(" ↕↑↓") == heading)
    return page.locator(f"#points tbody tr:not([hidden]) td:nth-child({at + 1})").all_inner_texts()


def frame(lab: Path, address: str) -> pd.DataFrame:
    """The table of a page, as the app gives it to who asks without a browser."""
    return twin_table(client(lab).get(address).text)


def marks(page: Page) -> Locator:
    """The points of the chart, as drawn; those of residuals stand in a chart of their own."""
    return page.locator("#chart .subplot.xy .scatterlayer .point")


# studies


def test_a_study_is_found_and_opened(page):
    page.goto("/")
    expect(page.locator("article.card:not([aria-busy])")).to_have_count(
        2, timeout=60 * MS
    )  # the first request fits laws
    expect(page.locator("article.card.broken")).to_have_count(0)
    expect(page.locator(f"#card-{STUDY} img")).to_have_count(POINTS)
    page.get_by_role("link", name=STUDY, exact=True).click()
    expect(page).to_have_url(re.compile(rf"/study/{STUDY}(\?|$)"))
    expect(page.get_by_role("heading", name=STUDY, level=1)).to_be_visible()


def test_the_chart_has_every_point_and_the_fits(page, lab):
    page.goto(f"/study/{STUDY}")
    table = frame(lab, f"/study/{STUDY}.csv")
    measured = len(table.dropna(subset=["flow_rate"]))
    assert measured == POINTS
    chart = page.locator("#chart")
    expect(chart).to_have_attribute("data-points", str(measured))
    expect(chart).to_have_attribute("data-fits", "2")
    expect(marks(page)).to_have_count(measured)
    heights = [box["y"] for one in marks(page).all() if (box := one.bounding_box())]
    assert heights == sorted(heights, reverse=True), "the wider the outlet, the higher"
    drawn = [one for one in chart.locator(".subplot.xy .js-line").all() if "stroke-width: 2px" in str(
        one.get_attribute("style"))]  # fmt: skip
    assert len(drawn) == 2, "two laws; bands have no line"
    assert all(len(str(one.get_attribute("d"))) > 100 for one in drawn)
    page.get_by_label("Janda", exact=True).uncheck()
    expect(chart).to_have_attribute("data-fits", "1")
    expect(page).to_have_url(re.compile("fits=janda"))
    page.reload()
    expect(chart).to_have_attribute("data-fits", "1")
    expect(page.get_by_label("Janda", exact=True)).not_to_be_checked()


def test_axes_are_chosen_and_kept_in_the_address(page):
    page.goto(f"/study/{PLANE}")
    page.get_by_label("Horizontal").select_option("container.angle")
    expect(page).to_have_url(re.compile("x=container.angle"))
    expect(page.locator("#chart .xtitle")).to_contain_text("deg")
    page.get_by_label("Scale").select_option("log")
    page.reload()
    expect(page.get_by_label("Horizontal")).to_have_value("container.angle")
    expect(page.get_by_label("Scale")).to_have_value("log")


def test_points_without_a_number_are_crosses(page, lab):
    page.goto(f"/study/{PLANE}")
    table = frame(lab, f"/study/{PLANE}.csv")
    measured = len(table.dropna(subset=["flow_rate"]))
    assert 0 < measured <= len(table) == 6
    expect(page.locator("#chart")).to_have_attribute("data-points", str(measured))
    expect(marks(page)).to_have_count(len(table))


def test_the_table_sorts_and_filters(page):
    page.goto(f"/study/{STUDY}")
    head = page.locator("#points th", has_text="W [g/s]")

    def flows() -> list[float]:
        return [float(one.split(" ±")[0]) for one in column(page, "W [g/s]")]

    at_first = flows()
    assert at_first == sorted(at_first)
    head.get_by_role("button").click()
    expect(head).to_have_attribute("aria-sort", "ascending")
    head.get_by_role("button").click()
    expect(head).to_have_attribute("aria-sort", "descending")
    assert flows() == sorted(at_first, reverse=True)
    page.reload()
    expect(head).to_have_attribute("aria-sort", "descending")
    assert flows() == sorted(at_first, reverse=True)
    page.get_by_label("Filter the table").fill("57.8")
    expect(page.locator("#points-count")).to_have_text(f"1 of {POINTS} points")
    assert len(flows()) == 1
    page.reload()
    expect(page.locator("#points-count")).to_have_text(f"1 of {POINTS} points")


def brush(page: Page, axis: str, low: float, high: float) -> None:
    """Drag along a part of an axis, from the bottom (0) to the top (1)."""
    grip = page.locator(f'#parallel .grip[data-axis="{axis}"]')
    grip.scroll_into_view_if_needed()
    box = grip.bounding_box()
    assert box
    x = box["x"] + box["width"] / 2
    page.mouse.move(x, box["y"] + box["height"] * (1 - low))
    page.mouse.down()
    page.mouse.move(x, box["y"] + box["height"] * (1 - (low + high) / 2), steps=3)
    page.mouse.move(x, box["y"] + box["height"] * (1 - high), steps=3)
    page.mouse.up()


def test_a_range_chooses_rows_and_points_and_stays_in_the_address(page):
    page.goto(f"/study/{PLANE}#all-points")
    expect(page.locator("#parallel path")).to_have_count(6)
    brush(page, "container.angle", 0.6, 1.0)
    expect(page).to_have_url(re.compile("brush=container.angle"))
    expect(page.locator("#points-count")).to_have_text("3 of 6 points")
    assert set(column(page, "angle [deg]")) == {"90"}
    expect(page.locator("#parallel path.off")).to_have_count(3)

    def dimmed() -> int:
        """Points that are drawn fainter, each by itself or with its curve."""
        faint = "node => { for (let n = node; n && n.id !== 'chart'; n = n.parentElement)" \
                " if (Number(getComputedStyle(n).opacity) < 0.9) return true; return false; }"  # fmt: skip
        return sum(one.evaluate(faint) for one in marks(page).all())

    assert 0 < dimmed() < 6
    before = dimmed()
    page.reload()
    expect(page.locator("#points-count")).to_have_text("3 of 6 points")
    expect(page.locator("#parallel path.off")).to_have_count(3)
    assert dimmed() == before
    page.get_by_role("button", name="Clear all ranges").click()
    expect(page.locator("#points-count")).to_have_text("6 points")
    assert "brush" not in page.url
    assert dimmed() == 0


def test_ranges_are_also_chosen_by_numbers(page):
    page.goto(f"/study/{PLANE}#all-points")
    page.get_by_text("Ranges as numbers").click()
    fields = page.locator("#ranges fieldset", has_text=re.compile("D \\[mm\\]"))
    fields.get_by_label("from").fill("20")
    fields.get_by_label("from").press("Tab")
    expect(page.locator("#points-count")).to_have_text("4 of 6 points")


def test_a_click_on_a_point_leads_to_its_page(page):
    page.goto(f"/study/{STUDY}")
    expect(marks(page)).to_have_count(POINTS)
    page.locator("#chart").scroll_into_view_if_needed()
    box = marks(page).nth(2).bounding_box()
    assert box
    spot = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(spot[0] - 2, spot[1])
    page.mouse.move(*spot)
    expect(page.locator("#chart .hoverlayer .hovertext").first).to_be_visible()
    page.mouse.click(*spot)
    expect(page).to_have_url(re.compile(rf"/study/{STUDY}/point/3$"))
    expect(page.locator("#curves .scatterlayer .trace").first).to_be_attached()


def test_figures_are_drawn_when_they_are_opened(page):
    page.goto(f"/study/{PLANE}")
    page.get_by_text("W against angle", exact=True).click()
    image = page.locator("#figure-against-container-angle img")
    image.scroll_into_view_if_needed()
    expect(image).to_be_visible()
    assert image.evaluate("node => node.decode().then(() => node.naturalWidth)") > 100


# exploring


def explored(page: Page, name: str, query: str = "") -> Page:
    """The page that explores a study, drawn."""
    page.goto(f"/study/{name}/explore{query}")
    expect(page.locator("#field svg")).to_be_visible()
    expect(page.locator("#field")).to_have_attribute("data-blocks", re.compile("[1-9]"))
    return page


def test_sliders_move_the_design_and_the_address(page):
    explored(page, PLANE, "?at=27,75")
    expect(page.locator("#interval")).to_contain_text("95 %:")
    before = float(page.locator("#value").inner_text())
    slider = page.locator('#sliders input[data-key="container.orifice"]')
    slider.focus()
    slider.press("End")
    expect(page).to_have_url(re.compile(r"at=30(%2C|,)75"))
    assert float(page.locator("#value").inner_text()) > before
    exact = page.locator('#sliders input[data-exact="container.orifice"]')
    expect(exact).to_have_value("30")
    exact.fill("99")
    exact.press("Tab")
    expect(exact).to_have_value("30")  # nothing is asked beyond the swept range
    page.reload()
    expect(exact).to_have_value("30")


def test_the_map_has_all_points_and_bars_those_that_clogged(page, lab):
    explored(page, PLANE)
    table = frame(lab, f"/study/{PLANE}.csv")
    expect(page.locator("#field a[data-point]")).to_have_count(len(table))
    expect(page.locator("#field circle.barred")).to_have_count(len(table) - len(table.dropna(subset=["flow_rate"])))
    page.locator('#field a[data-point="4"]').click()
    expect(page).to_have_url(re.compile(rf"/study/{PLANE}/point/4$"))


def test_a_click_on_the_map_moves_the_design(page):
    explored(page, PLANE, "?at=27,75")
    area = page.locator("#field .hit").bounding_box()
    assert area
    page.mouse.click(area["x"] + 0.93 * area["width"], area["y"] + 0.5 * area["height"])
    expect(page.locator('#sliders input[data-exact="container.orifice"]')).not_to_have_value("27")


def test_a_wanted_value_is_answered_or_refused(page, lab):
    explored(page, STUDY, "?want=40")
    answer = page.locator("#answer")
    expect(answer).to_contain_text("W = 40 g/s needs D = ")
    said = float(re.search(r"D = ([\d.]+)", answer.inner_text())[1])  # pyright: ignore[reportOptionalSubscript]
    surface = labbook_results(lab, STUDY).explore()
    assert said == pytest.approx(1e3 * surface.inverse("40 g/s", "orifice").value, abs=0.05)
    page.locator("#want-number").fill("4000")
    page.locator("#want-number").press("Tab")
    expect(answer).to_contain_text("W = 4000 g/s is not reached")


def labbook_results(lab: Path, name: str) -> Results:
    return Lab(lab, backend="toy").results(load(lab / f"study-files/{name}.yaml"))


@pytest.mark.parametrize("name", [STUDY, PLANE])
def test_the_arithmetic_in_chromium_is_that_of_python(page, lab, name):
    explored(page, name)
    surface = labbook_results(lab, name).explore()
    designs, targets = questions(surface, np.random.default_rng(2))
    view = page.evaluate("labbook.data().views[0]")
    answers = page.evaluate(f"(given) => ({ANSWERS.strip()})(...given)", [view, designs, targets])
    compare(surface, answers, designs, targets)


def test_what_to_run_next_is_saved_as_a_study(page, tmp_path):
    explored(page, STUDY)
    with page.expect_download() as going:
        page.locator("section", has_text="What to run next").last.get_by_role("button", name="Download").click()
    assert going.value.suggested_filename == f"{STUDY}-next.yaml"
    path = tmp_path / "next.yaml"
    path.write_text(Path(going.value.path()).read_text())
    assert load(path).name == f"{STUDY}-next"
    page.get_by_text("This design as a study").click()
    with page.expect_download() as going:
        page.locator("#design-save").click()
    path.write_text(Path(going.value.path()).read_text())
    (point,) = load(path).points
    assert 0.018 <= float(point.at["container.orifice"]) <= 0.03


def test_a_site_explores_without_a_server(chromium, lab, tmp_path):
    labbook("site", tmp_path / "out", lab / f"study-files/{PLANE}.yaml", "--lab", lab)
    context = chromium.new_context(viewport=DESKTOP)
    page, wrong = context.new_page(), []
    page.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
    page.goto((tmp_path / f"out/study/{PLANE}/explore.html").as_uri())
    expect(page.locator("#field circle.point")).to_have_count(4)
    expect(page.locator("#interval")).to_contain_text("95 %:")
    page.locator('#field a[data-point="4"]').click()
    expect(page.get_by_role("heading", level=1)).to_contain_text("Point 4")
    context.close()
    assert wrong == []


# runs, comparisons, downloads, notes


def rows(page: Page) -> Locator:
    return page.locator("#list tbody tr")


def test_runs_are_filtered_in_place_and_back_goes_back(page, lab):
    every = frame(lab, "/runs.csv")
    clogged = every[every["outcome"] == "clogged"]
    assert 0 < len(clogged) < len(every) < 100
    page.goto("/runs")
    expect(rows(page)).to_have_count(len(every))
    page.evaluate("window.same = 1")
    page.get_by_label("Outcome").select_option("clogged")
    expect(rows(page)).to_have_count(len(clogged))
    expect(page).to_have_url(re.compile("outcome=clogged"))
    expect(page.locator("#total")).to_have_text(str(len(clogged)))
    page.get_by_label("Study").select_option(STUDY)
    expect(page.locator("#list .empty")).to_be_visible()
    assert page.evaluate("window.same") == 1, "only a part of the page was asked for"
    page.go_back()
    expect(rows(page)).to_have_count(len(clogged))
    expect(page.get_by_label("Study")).to_have_value("")
    page.go_back()
    expect(rows(page)).to_have_count(len(every))
    page.get_by_label("Text").fill("30 mm")
    expect(rows(page)).to_have_count(int(every["label"].str.contains("30 mm").sum()))


def test_back_works_before_the_scripts_have_come(page, lab):
    every = frame(lab, "/runs.csv")
    page.goto("/runs")
    page.get_by_label("Outcome").select_option("clogged")
    expect(page).to_have_url(re.compile("outcome=clogged"))
    page.route("**/htmx*", lambda route: None)  # never answered
    page.reload(wait_until="commit")
    expect(rows(page)).to_have_count(len(every[every["outcome"] == "clogged"]))
    page.go_back(wait_until="commit")
    expect(rows(page)).to_have_count(len(every))


def test_runs_are_sorted_by_their_headings(page, lab):
    page.goto("/runs")
    page.get_by_role("link", name="took [s]").click()
    expect(page).to_have_url(re.compile("sort=-wall_time"))
    first = rows(page).first.locator("a.key").inner_text()
    table = frame(lab, "/runs.csv")
    assert table.loc[table["wall_time"].idxmax(), "run_key"][:10] == first


def test_chosen_points_are_compared(page):
    page.goto(f"/study/{STUDY}")
    button = page.get_by_role("button", name="Compare chosen points")
    expect(button).to_be_disabled()
    for number in (1, 4):
        page.get_by_label(f"Choose point {number}", exact=True).check()
    button.click()
    expect(page).to_have_url(re.compile(r"/compare\?item="))
    expect(page.get_by_role("cell", name="18 mm")).to_be_visible()
    expect(page.locator("#curves .scatterlayer .trace").first).to_be_attached()


def test_downloads_are_the_files(page, lab):
    page.goto(f"/study/{STUDY}")
    with page.expect_download() as going:
        page.get_by_role("link", name="Download").click()
    assert Path(going.value.path()).read_text() == (lab / f"study-files/{STUDY}.yaml").read_text()
    assert going.value.suggested_filename == f"{STUDY}.yaml"
    key = keys_of(lab)[0]
    page.goto(f"/run/{key[:16]}")
    with page.expect_download() as going:
        page.get_by_role("link", name="crossing.npz").click()
    assert Path(going.value.path()).read_bytes() == (lab / "runs" / key / "crossing.npz").read_bytes()


def test_a_note_is_saved_and_shown_again(page, lab):
    key = keys_of(lab)[1]
    page.goto(f"/run/{key[:16]}")
    page.get_by_role("heading", name="Notes").click()
    page.get_by_label("Tags").fill("odd, seen")
    page.locator("textarea[name=text]").fill("Arch at <0.3 s>\nof the wall & more")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("Saved in the lab.")).to_be_visible()
    page.reload()
    expect(page.locator("textarea[name=text]")).to_have_value("Arch at <0.3 s>\nof the wall & more")
    expect(page.get_by_label("Tags")).to_have_value("odd, seen")
    assert notes.read(LabFolder(lab), "run", key).tags == ("odd", "seen")
    notes.write(LabFolder(lab), "run", key, notes.Note())


def test_a_tag_that_cannot_be_is_said_beside_what_was_written(chromium, base, lab):
    context = chromium.new_context(base_url=base)
    page = context.new_page()
    page.goto(f"/run/{keys_of(lab)[1][:16]}")
    page.get_by_role("heading", name="Notes").click()
    page.get_by_label("Tags").fill("two words")
    page.locator("textarea[name=text]").fill("mine")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("alert")).to_contain_text("Not saved")
    expect(page.locator("textarea[name=text]")).to_have_value("mine")
    context.close()


# keyboard


def tab_to(page: Page, wanted: str, most: int = 80) -> None:
    """Press Tab until the link to an address has the focus, and see that one sees where the focus is."""
    for _ in range(most):
        page.keyboard.press("Tab")
        here = page.evaluate(
            "(() => { const a = document.activeElement, s = getComputedStyle(a); return [a.getAttribute('href') || '',"
            " s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) > 0]; })()"
        )
        if re.fullmatch(wanted, here[0]):
            assert here[1], "the focus is seen"
            return
    pytest.fail(f"{wanted} is not reached within {most} presses of Tab")


def test_keys_lead_from_the_top_to_a_run(page):
    page.goto("/")
    expect(page.locator("article.card:not([aria-busy])")).to_have_count(2)
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    tab_to(page, f"/study/{STUDY}")
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile(rf"/study/{STUDY}(\?|$)"))
    expect(page.locator("#chart")).to_have_attribute("data-points", str(POINTS))
    tab_to(page, f"/study/{STUDY}/point/2")
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile(r"/point/2$"))
    tab_to(page, r"/run/[0-9a-f]+")
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile("/run/"))
    expect(page.get_by_role("heading", level=1)).to_contain_text("seed")


# everything, light and dark, wide and narrow


def addresses(lab: Path) -> list[str]:
    """One page of each kind, and pages that refuse."""
    keys = keys_of(lab)
    return [
        "/", f"/study/{STUDY}", f"/study/{PLANE}", f"/study/{STUDY}/explore", f"/study/{PLANE}/explore",
        f"/study/{STUDY}/point/1", f"/study/{PLANE}/point/1",
        f"/run/{keys[0][:16]}", "/runs", "/runs?study=none", "/compare", f"/?q={'none' * 20}",
        f"/compare?item=run:{keys[0][:16]}&item=run:{keys[1][:16]}",
        f"/compare?item=study:{STUDY}&item=study:{PLANE}",
    ]  # fmt: skip


def settled(page: Page) -> None:
    """All that is folded is open, and all that is drawn late is there: what comes when it is seen, and charts."""
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    place = 0
    while place < page.evaluate("document.documentElement.scrollHeight"):  # figures are higher than their places
        page.evaluate(f"window.scrollTo(0, {place})")
        page.wait_for_timeout(250)  # htmx looks five times a second at what has come into sight
        place += 500
    page.wait_for_load_state("networkidle", timeout=120 * MS)  # figures are drawn on a loaded machine too
    page.evaluate("window.scrollTo(0, 0)")
    expect(page.locator("[aria-busy=true]")).to_have_count(0, timeout=60 * MS)  # figures are drawn one by one


RUN_AXE = """(async () => {
  const found = await axe.run(document, { resultTypes: ["violations"] });
  return found.violations.filter((one) => ["serious", "critical"].includes(one.impact))
    .map((one) => `${one.id}: ${one.help} (${one.nodes.slice(0, 3).map((node) => node.target.join(" ")).join("; ")})`);
})()"""


@pytest.mark.parametrize("phone", [False, True], ids=["desktop", "phone"])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_every_page_is_sound_for_everybody(chromium, base, lab, dark, phone):
    """Nothing fails and nothing is asked of other machines (see `opened`); no serious violation of the rules for
    accessible pages; on a phone no page is wider than the screen."""
    found = {}
    for one in addresses(lab):
        with opened(chromium, base, dark=dark, phone=phone) as page:
            assert page.goto(one).status == 200  # pyright: ignore[reportOptionalMemberAccess]
            settled(page)
            page.evaluate(AXE)
            if wrong := page.evaluate(RUN_AXE):
                found[one] = wrong
            wide = page.evaluate("document.documentElement.scrollWidth")
            if wide > page.evaluate("window.innerWidth"):
                found[f"{one}: width"] = wide
    assert found == {}


def test_axe_finds_what_is_wrong(page):
    """So that no violation above means something."""
    page.goto("/runs")
    page.evaluate("document.querySelector('#q').closest('label').replaceWith(document.querySelector('#q'))")
    page.evaluate(AXE)
    assert any(one.startswith("label") for one in page.evaluate(RUN_AXE))


def test_what_is_not_there_is_said_without_an_error(chromium, base):
    context = chromium.new_context(base_url=base)
    page = context.new_page()
    for one, word in (("/study/none", "no study file"), ("/runs?no=1", "not known here"), ("/none", "Not")):
        answer = page.goto(one)
        assert answer is not None
        assert 400 <= answer.status < 500
        expect(page.locator("main")).to_contain_text(word)
        expect(page.get_by_role("link", name="All studies")).to_be_visible()
    context.close()


def test_a_study_without_numbers_has_no_chart_and_says_why(chromium, tmp_path):
    """Nothing fails, although nothing is drawn (see `opened`)."""
    why = "No flow rate at D = 18 mm; D = 24 mm: fewer than 60 grains"
    make(tmp_path, count=100, orifices="[18, 24]", replicates=1)
    with serving(tmp_path / "lab") as base, opened(chromium, base) as page:
        page.goto(f"/study/{STUDY}")
        expect(page.locator("section[aria-labelledby=chart-title]")).to_contain_text(why)
        expect(page.locator("select")).to_have_count(0)
        page.goto(f"/compare?item=study:{STUDY}")
        expect(page.locator("#chart-note")).to_contain_text(why)
        expect(page.locator("#axes")).to_be_hidden()
        expect(page.locator("#chart")).to_be_hidden()


# while a study runs


def test_a_study_is_followed_while_it_runs(chromium, tmp_path):
    lab = tmp_path / "lab"
    path = study_file(tmp_path, count=400, orifices="[18, 21, 24, 30]", replicates=2)
    with serving(lab, path) as base, opened(chromium, base) as page:
        page.goto(f"/study/{STUDY}")
        expect(page.locator("#main")).to_contain_text("No finished run")
        running = start("run", path, "--lab", lab, "--backend", "toy", delay=0.1)
        try:
            end = time.monotonic() + 60
            while not page.locator(".live").count():
                assert time.monotonic() < end, "a page that is opened while a study runs says so"
                page.wait_for_timeout(MS)
                page.reload()
            page.evaluate("window.same = 1")
            seen, points = set(), set()
            end = time.monotonic() + 150
            while time.monotonic() < end and running.poll() is None:
                seen.add(int(page.locator(".progress").first.get_attribute("data-done") or 0))
                chart = page.locator("#chart")
                if chart.count():
                    points.add(int(chart.first.get_attribute("data-points") or 0))
                page.wait_for_timeout(300)
            assert running.wait(60) == 0
        finally:
            running.kill()
            running.communicate()
        assert len(seen) >= 3, "the bar grows"
        assert len(points) >= 2, "points come to the chart"
        expect(page.locator(".progress").first).to_have_attribute("data-done", "8")
        expect(page.locator(".live")).to_have_count(0)
        expect(page.locator("#chart")).to_have_attribute("data-points", "4")
        assert page.evaluate("window.same") == 1, "nobody loaded the page again"


# the viewer


@pytest.fixture(scope="module")
def filmed(tmp_path_factory) -> Path:
    """A lab with one recorded run of the quick start on the CPU backend."""
    pytest.importorskip("rerun")
    folder = tmp_path_factory.mktemp("filmed")
    text = (ROOT / "studies/quickstart.yaml").read_text()
    text = re.sub(r'orifice: "\[.*\] mm"', 'orifice: "[30] mm"', text)
    text = re.sub(r"^replicates: \d+", "replicates: 1", text, flags=re.MULTILINE)
    (folder / "one.yaml").write_text(text)
    running = start("run", folder / "one.yaml", "--lab", folder / "lab", "--backend", "numba")
    out, err = running.communicate(timeout=500)
    assert running.returncode == 0, out + err
    return folder / "lab"


def pixels(shown: Locator) -> np.ndarray:
    """What is seen of an element."""
    return np.asarray(Image.open(io.BytesIO(shown.screenshot())).convert("RGB"), float)


def differing(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the pixels that differ clearly."""
    height, width = (min(sizes) for sizes in zip(one.shape[:2], other.shape[:2], strict=True))
    return float(np.mean(np.abs(one[:height, :width] - other[:height, :width]).max(axis=2) > 40))


@pytest.mark.compiles
@pytest.mark.render
def test_the_viewer_shows_the_grains_of_a_run(chromium, filmed):
    """The viewer with the recording differs from one without by much more than two looks at the latter do."""
    (key,) = keys_of(filmed)
    context = chromium.new_context(color_scheme="light", viewport=DESKTOP)
    with serving(filmed) as base:
        page = context.new_page()
        asked = []
        context.on("request", lambda one: asked.append(one.url))
        page.goto(f"{base}/run/{key[:16]}")
        page.get_by_role("button", name="Open in the viewer").click()
        frame = page.locator("iframe")
        expect(frame).to_be_visible(timeout=120 * MS)
        expect(frame).to_have_attribute("data-opened", "", timeout=90 * MS)  # it plays from mid-window on
        source = str(frame.get_attribute("src"))
        box = frame.bounding_box()
        assert box
        empty = context.new_page()
        empty.set_viewport_size({"width": round(box["width"]), "height": round(box["height"])})
        empty.goto(base + re.sub(r"url=[^&]*&", "", source))
        empty.wait_for_timeout(25 * MS)
        first = pixels(empty.locator("body"))
        empty.wait_for_timeout(3 * MS)
        noise = differing(first, pixels(empty.locator("body")))
        empty.close()
        page.bring_to_front()
        share, end = 0.0, time.monotonic() + 90
        while share < 0.05 + 3 * noise and time.monotonic() < end:
            page.wait_for_timeout(2 * MS)
            share = differing(first, pixels(frame))
        assert noise < 0.02
        assert share > 0.05 + 3 * noise
        assert [one for one in asked if not one.startswith((f"{base}/", "data:", "blob:"))] == []
        assert any(one.endswith(".rrd") for one in asked)
    context.close()


def test_the_chart_draws_what_its_note_says(chromium, base):
    """Crosses on the lower edge of a logarithmic scale; markers of series in the legend; intervals in hovers; powers of
    flow rates only; and what is not drawn is named."""
    with opened(chromium, base) as page:
        page.goto(f"/study/{PLANE}?scale=log")
        expect(page.locator("#chart-note")).to_contain_text("Crosses on the lower edge: 2 without a number.")
        drawn = page.evaluate("document.getElementById('chart').data")
        crosses = [one for one in drawn if one.get("marker", {}).get("symbol") == "x-thin"]
        assert [(one["yaxis"], one["y"]) for one in crosses] == [("y3", [0])] * 2
        (first,), (second,) = (one["x"] for one in crosses)
        assert first < 8 < second, "side by side"
        assert first * second == pytest.approx(8**2), "as far to the left as to the right on this scale"
        legend = [one for one in drawn if one.get("meta") == "legend"]
        assert [one["showlegend"] for one in legend] == [True, True]
        assert all(isinstance(one["marker"]["color"], str) and one["x"] == [None] for one in legend)
        hovers = [text for one in drawn if one.get("customdata") for text in one["hovertemplate"] if "no W" not in text]
        assert all(re.search(r"W = [\d.]+ \([\d.]+ to [\d.]+, 95 %\), n = 2 g/s", text) for text in hovers)
        scales = page.locator("select[name=scale] option")
        expect(scales).to_have_text(["linear", "logarithmic", "W to the power 2/3"])
        page.goto(f"/study/{PLANE}")
        expect(page.locator("#chart-note")).to_contain_text("Points at one value stand side by side.")
        drawn = page.evaluate("document.getElementById('chart').data")
        curves = [one["x"] for one in drawn if one.get("customdata") and one["marker"]["symbol"] != "x-thin"]
        assert np.mean(curves, axis=0) == pytest.approx([24, 30])
        assert (np.diff(curves, axis=0) > 0.01 * (30 - 8)).all(), "about the width of a marker"
        page.goto(f"/study/{STUDY}")
        expect(page.locator("#chart-note")).not_to_contain_text("side by side")
        page.goto(f"/study/{PLANE}?y=flow_rate_drift&scale=power")
        expect(page.locator("select[name=scale] option", has_text="power")).to_have_count(0)
        page.goto(f"/compare?item=study:{PLANE}&item=study:{STUDY}")
        page.locator("select[name=x]").select_option("container.angle")
        expect(page.locator("#chart-note")).to_contain_text(f"Not drawn, without angle: {STUDY}.")


def test_a_film_plays_beside_its_tile(chromium, lab, tmp_path):
    """While the pointer stays on the tile; Escape takes it away. Only the run with a film in the lab has one."""
    shutil.copytree(lab, tmp_path / "lab")
    folder = next(path.parent for path in sorted((tmp_path / "lab").glob("runs/*/recording.npz"))
                  if RunRecord.read(path.parent).study == STUDY)  # fmt: skip
    record = RunRecord.read(folder)
    path = path_of(tmp_path / "lab/films", record, None, None, "-layers.webp")
    film(shot_of_run(folder, "layers"), path, seconds=0.2, size=60, source=source_of_film(record))
    with serving(tmp_path / "lab") as base, opened(chromium, base) as page:
        page.goto(f"/study/{STUDY}")
        (tile,) = page.locator("a[data-film]").all()
        tile.hover()
        film_shown = page.locator("img.playing")
        expect(film_shown).to_be_visible(timeout=60 * MS)
        expect(film_shown).to_have_attribute("src", f"/run/{record.run_key[:16]}/film.webp")
        page.keyboard.press("Escape")
        expect(film_shown).to_have_count(0)


def test_beds_of_a_card_move_while_the_pointer_is_on_it(chromium, lab):
    """Once by themselves, for five seconds, and then only there; not at all for who asks for less motion. The beds of
    runs without frames stand still."""
    recorded = {path.parent.name[:16] for path in lab.glob("runs/*/recording.npz")}
    with serving(lab) as base, opened(chromium, base) as page:
        page.goto("/")
        card = page.locator(f"#card-{STUDY}")
        beds = card.locator("img")
        expect(card).to_have_attribute("data-moving", "", timeout=60 * MS)
        shown = [str(bed.get_attribute("src")) for bed in beds.all()]
        keys = [one.split("/")[2] for one in shown]
        assert [one.endswith("/loop.webp") for one in shown] == [key in recorded for key in keys]
        assert any(key in recorded for key in keys)
        expect(card).not_to_have_attribute("data-moving", "", timeout=20 * MS)
        assert [bed.get_attribute("src") for bed in beds.all()] == [f"/run/{key}/picture.png" for key in keys]
        card.hover()
        expect(card).to_have_attribute("data-moving", "")
        page.mouse.move(2, 2)
        expect(card).not_to_have_attribute("data-moving", "")
        context = chromium.new_context(base_url=base, viewport=DESKTOP, reduced_motion="reduce")
        still = context.new_page()
        still.goto("/")
        still.locator(f"#card-{STUDY} img").first.wait_for()
        still.locator(f"#card-{STUDY}").hover()
        still.wait_for_timeout(2 * MS)
        assert still.locator("[data-moving]").count() == 0
        context.close()
