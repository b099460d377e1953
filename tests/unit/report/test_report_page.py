"""The page needs nothing beside it and shows what was found."""

import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from datetime import date
from html.parser import HTMLParser
from pathlib import Path

import pytest
from toy_results import analyse

from labbook.fit import LAWS
from labbook.papers.fan2023.profiles import ProfileFit
from labbook.report import page as report_page
from labbook.report.blocks import Beside, Folded, Prose, Section, Verbatim, anchored
from labbook.report.fitted_tables import parameter_row
from labbook.report.formulas import mathml
from labbook.report.page import summary, write
from labbook.report.result_box import concerns, result_box
from labbook.report.tables import Table
from labbook.results import display
from labbook.study.schema import Accuracy


class Reader(HTMLParser):
    """Collects what a browser would fetch, places within the page and links to them, headings, tags left open, and the
    text. `within`: of every table and picture, the classes of what it lies in."""

    def __init__(self):
        super().__init__()
        self.fetched, self.linked, self.places, self.headings = [], [], [], []
        self.open, self.classes, self.text, self.within, self.alts = [], [], [], [], []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        if tag in {"table", "img"}:
            self.within.append((tag, {one for one in self.classes if one}))
        if tag == "img":
            self.alts.append(given.get("alt", ""))
        if tag not in {"meta", "img", "br", "link"}:
            self.open.append(tag)
            self.classes.append(given.get("class"))
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(int(tag[1]))
        if "id" in given:
            self.places.append(given["id"])
        for target in (given[name] or "" for name in ("src", "href") if name in given):
            (self.linked if target.startswith("#") else self.fetched).append(target)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        self.classes.pop()

    def handle_data(self, data):
        self.text.append(data)


def read(path) -> Reader:
    reader = Reader()
    reader.feed(path.read_text(encoding="utf-8"))
    reader.close()
    assert not reader.open
    return reader


@pytest.fixture(scope="module")
def written(analysis, tmp_path_factory) -> Path:
    """The page of the column, with its figures beside it."""
    return write(analysis, tmp_path_factory.mktemp("report"), date(2026, 2, 3))


def test_the_page_is_one_file_that_fetches_nothing(written):
    page = read(written)
    assert len(page.fetched) == 4
    assert all(source.startswith("data:image/svg+xml;base64,") for source in page.fetched)
    assert "url(" not in written.read_text(encoding="utf-8")


def test_every_figure_lies_beside_it_in_three_formats(written):
    made = {path.name for path in written.parent.iterdir()}
    stems = ("fit", "flow", "start-beverloo", "start-janda")
    assert made == {"report.html", *(f"{stem}.{kind}" for stem in stems for kind in ("png", "svg", "pdf"))}


def test_warnings_of_the_plan_that_limit_numbers_reach_the_results(synthetic):
    """400 grains in a hopper 33 diameters wide are less than 1.2 widths high from the start: W may fall with that."""
    from labbook.plan.advice import limits

    points = [synthetic.point(k, D, count=400) for k, D in enumerate((0.024, 0.03))]
    low = analyse(synthetic.study_of(points), [synthetic.FinishedDouble(p, s) for p in points for s in (1, 2)])
    (warned,) = limits(low.study)
    said = [text for text in concerns(low) if "widths high before the window ends" in text]
    assert [warned.split(": ", 1)[1].replace("\n    remedy: ", " (remedy: ") + ")."] == said
    assert ("Attention", said[0]) in result_box(low).rows
    high = [synthetic.point(0, 0.03, count=4000)]
    enough = analyse(synthetic.study_of(high), [synthetic.FinishedDouble(high[0], s) for s in (1, 2)])
    assert not any("widths high" in text for text in concerns(enough))


def test_points_that_are_the_same_runs_are_told(synthetic):
    class SameRun(synthetic.FinishedDouble):
        def __init__(self, point, seed):
            super().__init__(point, seed)
            object.__setattr__(self, "entry", replace(self.entry, run_key=f"{seed:032x}"))

    points = [
        synthetic.point(0, 0.03),
        replace(synthetic.point(1, 0.03), at={"container.orifice": 0.03, "unused": 2.0}),
    ]
    found = analyse(synthetic.study_of(points), [SameRun(one, seed) for one in points for seed in (1, 2)])
    assert any(text.startswith("These points are the same runs") for text in concerns(found))


def test_it_shows_the_numbers_of_the_analysis(analysis, written):
    text = " ".join(" ".join(read(written).text).split())
    for result in analysis.points:
        flow = result.flow_rate
        value, low, high = (display.number(one, flow.error, 1e3) for one in (flow.value, flow.low, flow.high))
        assert f"{value} {low} to {high} (±" in text
    assert "C (grain density)" in text
    assert "C (bulk density)" in text
    assert "inside interval" in text
    assert "no finished point has these values" in text
    assert "24 runs of 8 points." in text
    assert "versions numpy" in text
    assert analysis.points[0].runs[0].run_key in text


@pytest.mark.slow
def test_the_same_analysis_gives_the_same_page_on_the_same_day(analysis, written, tmp_path, monkeypatch):
    assert "newest run of 3 January 2026, report of 3 February 2026" in written.read_text(encoding="utf-8")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1770076800")  # 3 February 2026
    assert write(analysis, tmp_path).read_bytes() == written.read_bytes()


def test_the_box_has_the_numbers_of_the_analysis(analysis):
    """Ends of W, parameters and verdict, as they are found and not as a table shows them."""
    found = dict(result_box(analysis).rows)
    lowest, highest = analysis.points[0], analysis.points[-1]
    for result in (lowest, highest):
        value = display.with_error(result.flow_rate.value, result.flow_rate.error, 1e3)
        assert f"{value} g/s ({result.label})" in found["Flow rate"]
    (series,) = analysis.series
    for name in ("C", "C_particle", "k"):
        _, value, _ = parameter_row(f"beverloo.{name}", series.fits["beverloo"].parameters[name])
        assert f"= {value}" in found["Beverloo"]
    assert found["Law"] == series.verdict
    assert found["Runs"] == "24 runs of 8 points."
    assert "Of 3 numbers of Fan et al. 2023" in found["Fan et al. 2023"]


def test_the_box_has_the_interval_of_a_parameter_without_a_standard_error(analysis, monkeypatch):
    monkeypatch.setattr("labbook.report.result_box.parameter_row", lambda *_: ("", "504.9", "9.964 to 611.4"))
    assert "k = 504.9 (95 %: 9.964 to 611.4)" in dict(result_box(analysis).rows)["Beverloo"]


def test_the_box_names_what_clogged_and_what_diverged(synthetic):
    points = [synthetic.point(k, D) for k, D in enumerate((0.018, 0.03))]
    ends = {(0, 1): "clogged", (1, 2): "diverged"}
    runs = [synthetic.FinishedDouble(p, s, ends.get((p.index, s), "emptied")) for p in points for s in (1, 2, 3)]
    box = result_box(analyse(synthetic.study_of(points), runs))
    attention = [text for term, text in box.rows if term in box.marked]
    assert "1 run clogged: D = 18 mm (1 of 3)." in attention
    assert "1 run diverged: D = 30 mm (1 of 3)." in attention


def test_points_with_runs_but_without_a_flow_rate_are_named_with_reason_and_remedy(synthetic):
    points = [synthetic.point(k, D, count=n) for k, (D, n) in enumerate(((0.03, 80), (0.036, 80), (0.018, 1200)))]
    runs = [synthetic.FinishedDouble(p, s, "clogged" if p.index == 2 else "emptied") for p in points for s in (1, 2)]
    said = [text for text in concerns(analyse(synthetic.study_of(points), runs)) if text.startswith("No flow rate")]
    assert said == [
        "No flow rate at D = 30 mm; D = 36 mm: fewer than 60 grains flowed out within the window "
        "(use more grains or a wider window); at D = 18 mm: "
        "runs clogged (use a wider outlet, or measure: [clogging])."
    ]


@pytest.fixture(scope="module")
def swept(synthetic, tmp_path_factory):
    """The page on three angles of a hopper with two orifices."""
    points = [synthetic.point(2 * i + k, D, 0.5 * (i + 1)) for i in range(3) for k, D in enumerate((0.024, 0.03))]
    runs = [synthetic.FinishedDouble(p, s) for p in points for s in (1, 2, 3)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("labbook.report.style.FORMATS", ("svg",))  # the others are looked at elsewhere
        return write(analyse(synthetic.study_of(points), runs), tmp_path_factory.mktemp("swept"))


def test_what_was_swept_comes_before_any_point_or_series(swept):
    page = read(swept)
    text = " ".join(" ".join(page.text).split())
    places = [text.index(words, text.index("Contents")) for words in ("Flow rate against angle", "Series by series")]
    assert places == sorted(places)
    assert "D = 24 mm: W at angle = " in text
    assert (swept.parent / "against-container-angle.svg").is_file()


def test_contents_link_to_every_section_and_every_link_has_its_place(swept):
    page = read(swept)
    assert len(set(page.places)) == len(page.places)
    assert {link.removeprefix("#") for link in page.linked} == set(page.places) - {"result", "contents"}
    titles = re.findall(r"<h2>(.*?)</h2>", swept.read_text(encoding="utf-8"))
    listed = re.findall(r'<li><a href="#[^"]*">(.*?)</a>', swept.read_text(encoding="utf-8"))
    assert set(titles) - {"Contents"} <= set(listed)


def test_what_is_wide_scrolls_by_itself_and_headings_skip_no_level(swept):
    page = read(swept)
    assert {tag for tag, _ in page.within} == {"table", "img"}
    assert all("wide" in classes for tag, classes in page.within if tag == "table")
    assert all("card" in classes for tag, classes in page.within if tag == "img")
    assert all(page.alts)
    assert page.headings[0] == 1
    assert all(after - before <= 1 for before, after in zip(page.headings, page.headings[1:], strict=False))
    style = swept.read_text(encoding="utf-8").partition("</style>")[0]
    assert "prefers-color-scheme: dark" in style
    assert re.search(r"\.wide \{ overflow-x: auto", style)
    columns = re.findall(r"grid-template-columns: ([^;}]*)", style)
    assert all("minmax(0, 1fr)" in one for one in columns), "a column that may not shrink pushes the page wide"


def test_provenance_the_study_file_and_keys_are_folded(analysis, written):
    text = written.read_text(encoding="utf-8")
    shown = re.sub(r"<details>.*?</details>", "", text, flags=re.DOTALL)
    key = analysis.points[0].runs[0].run_key
    assert key in text
    assert key not in shown
    assert "<details>" not in shown


@pytest.mark.usefixtures("one_format")
def test_a_section_from_elsewhere_needs_no_change_of_the_page(analysis, tmp_path, monkeypatch):
    """As a paper's own part would return it: every kind of block, nested, and a title that is taken already."""

    def more(results, folder):
        table = Table(("a", "b_c"), (("one & two", "10^(3)"),))
        inner = Section("Inner", (Beside((Prose("left"),), (Prose("right"),)), Folded("More", (Verbatim("<raw>"),))))
        return [Section("Flow rates", (Prose("From elsewhere.", note=True), table, inner))]

    monkeypatch.setattr(report_page, "PARTS", (*report_page.PARTS, more))
    path = write(analysis, tmp_path)
    page, text = read(path), path.read_text(encoding="utf-8")
    assert {"flow-rates", "flow-rates-2", "inner"} <= set(page.places)
    assert "one &amp; two" in text
    assert "b<sub>c</sub>" in text
    assert "10<sup>3</sup>" in text
    assert "&lt;raw&gt;" in text


def test_anchors_are_unique_whatever_titles_say():
    made = anchored([Section("δ", ()), Section("A b", (Section("A b", ()),)), Section("A-b", ())], {"result"})
    assert [one.anchor for one in made] == ["section", "a-b", "a-b-3"]
    assert made[1].subsections[0].anchor == "a-b-2"


@pytest.mark.usefixtures("one_format")
def test_points_without_a_fit_share_one_section(synthetic, tmp_path):
    points = [synthetic.point(k, 0.03, 0.5 * (k + 1)) for k in range(3)]
    found = analyse(
        synthetic.study_of(points, fit=()), [synthetic.FinishedDouble(p, s) for p in points for s in (1, 2)]
    )
    text = " ".join(read(write(found, tmp_path)).text)
    assert text.count("W(t) of every replicate.") == 1
    assert (tmp_path / "flow.svg").is_file()
    assert not (tmp_path / "flow-1.svg").exists()


@pytest.mark.parametrize("text", [*(law.formula for law in LAWS.values()), ProfileFit.formula])
def test_every_formula_is_typeset(text):
    """Well-formed MathML, with all letters and numbers of the plain one in their order, greek ones as such."""
    tree = ElementTree.fromstring(mathml(text))
    assert tree.tag == "math"
    assert tree.get("alttext") == text
    assert "_" not in "".join(tree.itertext())
    written = re.findall(r"[A-Za-z]+|\d+", re.sub(r"sqrt", "", text))
    names = {"alpha": "α", "gamma": "γ", "kappa": "κ", "phi": "φ", "rho": "ρ"}
    leaves = [one.text.strip("′") for one in tree.iter() if one.tag in ("mi", "mn") and one.text]
    assert leaves == [names.get(one, one) for one in written]


def test_a_formula_has_powers_roots_and_subscripts():
    found = mathml("W = rho_b sqrt(g) (D - k d)^(3/2)")
    assert "<msub><mi>ρ</mi><mi>b</mi></msub><msqrt><mi>g</mi></msqrt>" in found
    power = "<msup><mrow><mo>(</mo><mi>D</mi><mo>−</mo><mi>k</mi><mi>d</mi><mo>)</mo></mrow>"
    assert power + "<mrow><mn>3</mn><mo>/</mo><mn>2</mn></mrow></msup>" in found


@pytest.mark.parametrize("text", ["a (b", "b)", "sqrt g", "x^", "50 % & <b>"])
def test_what_cannot_be_typeset_is_shown_as_it_is(text):
    assert "<math" not in mathml(text)
    assert "<b>" not in mathml(text)


@pytest.mark.render
def test_a_browser_needs_no_room_beyond_a_narrow_screen(swept, tmp_path):
    """Within a frame of 400 px nothing lies beyond what is seen: figures and tables scroll by themselves."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("needs chromium")
    root = "document.documentElement"
    told = f"<script>onload=()=>parent.postMessage([{root}.clientWidth,{root}.scrollWidth],'*')</script></body>"
    page = swept.read_text(encoding="utf-8").replace("</body>", told)
    (tmp_path / "report.html").write_text(page, encoding="utf-8")
    outer = tmp_path / "outer.html"
    outer.write_text(
        "<body><script>onmessage=e=>document.body.dataset.width=e.data</script>"
        '<iframe src="report.html" style="width:400px;height:800px;border:0"></iframe></body>'
    )
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=5000", "--dump-dom"]
    shown = subprocess.run([*command, outer.as_uri()], capture_output=True, text=True, timeout=60, check=True).stdout
    widths = re.search(r'data-width="(\d+),(\d+)"', shown)
    assert widths is not None
    seen, whole = map(int, widths.groups())
    assert 300 < seen <= 400
    assert whole == seen


@pytest.mark.usefixtures("one_format")
def test_what_a_study_says_cannot_break_the_page(synthetic, tmp_path):
    point = synthetic.point(0, 0.03)
    study = synthetic.study_of([point], about="<script>alert(1)</script> & so on")
    path = write(analyse(study, [synthetic.FinishedDouble(point, 1)]), tmp_path)
    assert "<script" not in path.read_text(encoding="utf-8")
    assert "<script>alert(1)</script> & so on" in " ".join(read(path).text)


@pytest.mark.usefixtures("one_format")
def test_a_single_run_has_no_error_and_says_so(synthetic, tmp_path):
    point = synthetic.point(0, 0.03)
    analysis = analyse(synthetic.study_of([point]), [synthetic.FinishedDouble(point, 1)])
    text = " ".join(read(write(analysis, tmp_path)).text)
    assert "unknown" in text
    assert "1 orifice is too few" in text


@pytest.mark.usefixtures("one_format")
def test_runs_that_all_clogged_are_reported_without_a_fit(synthetic, tmp_path):
    points = [synthetic.point(k, D) for k, D in enumerate((0.018, 0.03))]
    runs = [synthetic.FinishedDouble(point, seed, "clogged") for point in points for seed in (1, 2)]
    text = " ".join(read(write(analyse(synthetic.study_of(points), runs), tmp_path)).text)
    assert "2 of 2 clogged" in text
    assert "W of clogged runs while flowing" in text
    assert "Clogged runs while they flowed" in text


@pytest.mark.usefixtures("one_format")
def test_captions_tell_of_nothing_that_is_not_drawn(synthetic, tmp_path):
    """Without `fit` there are neither laws nor residuals; of spheres no order; of too few grains no window."""
    points = [synthetic.point(2 * i + k, D, 0.5 * (i + 1)) for i in range(2) for k, D in enumerate((0.024, 0.03))]
    runs = [synthetic.FinishedDouble(p, s, recorded=s == 1) for p in points for s in (1, 2)]
    text = " ".join(read(write(analyse(synthetic.study_of(points, fit=(), reference=None), runs), tmp_path)).text)
    assert {"orifice-1.svg", "orifice-2.svg"} <= {path.name for path in tmp_path.iterdir()}
    assert not list(tmp_path.glob("fit*"))
    assert "Points at one D are drawn side by side." in text
    for absent in ("lines: fits", "residuals", "first law fitted", "orientation tensor", "Hollow points"):
        assert absent not in text
    few = [synthetic.point(k, D, count=80) for k, D in enumerate((0.024, 0.03))]
    study = synthetic.study_of(few, fit=(), reference=None)
    page = write(analyse(study, [synthetic.FinishedDouble(p, s) for p in few for s in (1, 2)]), tmp_path / "few")
    text = " ".join(read(page).text)
    assert "Shaded" not in text
    assert "W(t) of every replicate. No run has enough grains in the window for a mean." in text


def test_a_packing_fraction_that_could_not_be_measured_is_said(synthetic):
    points = [synthetic.point(0, 0.03, count=150), synthetic.point(1, 0.036)]
    runs = [synthetic.FinishedDouble(point, seed) for point in points for seed in (1, 2)]
    study = synthetic.study_of(points, measure=("packing",))
    (said,) = (one for one in summary(analyse(study, runs)) if "packing fraction" in one)
    assert said.startswith("No packing fraction in 2 of 4 runs: the bulk is smaller than 4 d: use more grains")
    assert not any("packing fraction" in one for one in summary(analyse(study, runs[2:])))


def test_the_summary_says_what_is_missing_and_what_falls_short(column, synthetic):
    study, finished = column
    accuracy = Accuracy(flow_rate=1e-5, max_replicates=3)
    changed = type(study)(**{**vars(study), "accuracy": accuracy, "measure": ("flow_rate",)})
    sentences = " ".join(summary(analyse(changed, [run for run in finished if run.point.index])))
    assert "Points without a finished run: D = 18 mm." in sentences
    assert re.search(r"requested error of 0\.001 % of the flow rate is not reached at D = 21 mm; ", sentences)
