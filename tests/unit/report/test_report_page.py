"""The page needs nothing beside it and shows what was found."""

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from toy_results import analyse

from labbook.report.page import summary, write
from labbook.results import display
from labbook.study.schema import Accuracy


class Reader(HTMLParser):
    """Collects what a browser would fetch, tags left open, and the text."""

    def __init__(self):
        super().__init__()
        self.fetched, self.open, self.text = [], [], []

    def handle_starttag(self, tag, attrs):
        if tag not in {"meta", "img", "br", "link"}:
            self.open.append(tag)
        self.fetched += [value for name, value in attrs if name in {"src", "href"}]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

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
    return write(analysis, tmp_path_factory.mktemp("report"))


def test_the_page_is_one_file_that_fetches_nothing(written):
    page = read(written)
    assert len(page.fetched) == 2
    assert all(source.startswith("data:image/svg+xml;base64,") for source in page.fetched)
    assert "url(" not in written.read_text(encoding="utf-8")


def test_every_figure_lies_beside_it_in_three_formats(written):
    made = {path.name for path in written.parent.iterdir()}
    assert made == {"report.html", *(f"{stem}.{kind}" for stem in ("fit", "flow") for kind in ("png", "svg", "pdf"))}


def test_it_shows_the_numbers_of_the_analysis(analysis, written):
    text = " ".join(" ".join(read(written).text).split())
    for result in analysis.points:
        assert display.with_error(result.flow_rate.value, result.flow_rate.error, 1e3) in text
    assert "C (grain density)" in text
    assert "C (bulk density)" in text
    assert "in standard errors" in text
    assert "no finished point is at these values" in text
    assert "24 runs of 8 points." in text
    assert "versions numpy" in text
    assert analysis.points[0].runs[0].run_key in text


def test_the_same_analysis_gives_the_same_page(analysis, written, tmp_path):
    assert write(analysis, tmp_path).read_bytes() == written.read_bytes()


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
    assert "1 orifices are too few" in text


@pytest.mark.usefixtures("one_format")
def test_runs_that_all_clogged_are_reported_without_a_fit(synthetic, tmp_path):
    points = [synthetic.point(k, D) for k, D in enumerate((0.018, 0.03))]
    runs = [synthetic.FinishedDouble(point, seed, "clogged") for point in points for seed in (1, 2)]
    text = " ".join(read(write(analyse(synthetic.study_of(points), runs), tmp_path)).text)
    assert "2 of 2 clogged" in text
    assert "W of clogged runs while flowing" in text


def test_a_packing_fraction_that_could_not_be_measured_is_said(synthetic):
    points = [synthetic.point(0, 0.03, count=150), synthetic.point(1, 0.036)]
    runs = [synthetic.FinishedDouble(point, seed) for point in points for seed in (1, 2)]
    study = synthetic.study_of(points, measure=("packing",))
    (said,) = (one for one in summary(analyse(study, runs)) if "packing fraction" in one)
    assert said.startswith("No packing fraction of 2 of 4 runs: the bulk is smaller than 4 d: fill in more grains")
    assert not any("packing fraction" in one for one in summary(analyse(study, runs[2:])))


def test_the_summary_says_what_is_missing_and_what_falls_short(column, synthetic):
    study, finished = column
    accuracy = Accuracy(flow_rate=1e-5, max_replicates=3)
    changed = type(study)(**{**vars(study), "accuracy": accuracy, "measure": ("flow_rate",)})
    sentences = " ".join(summary(analyse(changed, [run for run in finished if run.point.index])))
    assert "Not finished yet: D = 18 mm." in sentences
    assert re.search(r"asked error of 0\.001 % on the flow rate is not met at D = 21 mm; ", sentences)
