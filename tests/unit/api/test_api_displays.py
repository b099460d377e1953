"""What a notebook shows of labs, points, runs, traces and fits."""

import re
from base64 import b64encode
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from toy_lab import study

import labbook
from labbook.api.run import FilmPath
from labbook.html import table

FITTED = ("fit: [beverloo]",)


class Sound(HTMLParser):
    """Whether every element is closed."""

    def __init__(self, text: str):
        super().__init__()
        self.open: list[str] = []
        self.words = ""
        self.feed(text)
        assert not self.open, self.open

    def handle_starttag(self, tag, attrs):
        if tag not in ("img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_data(self, data):
        self.words += f" {data}"


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Results of a study on the toy backend."""
    folder = tmp_path_factory.mktemp("displays")
    lab = labbook.Lab(folder / "lab", "toy")
    asked = study(folder, *FITTED, orifices="[18, 21, 24, 30]", replicates=2)
    assert lab.run(asked, progress=False).complete
    return lab.results(asked, progress=False)


def words(thing: object) -> str:
    """The words of its display."""
    return " ".join(Sound(thing._repr_html_()).words.split())  # pyright: ignore[reportAttributeAccessIssue]


def test_a_run_shows_its_bed_and_its_numbers(found):
    run = found.run(2)
    assert "toy-study, orifice 21 mm, seed 1" in words(run)
    assert "finished" in words(run)
    rate = run.measured["flow_rate"].value * 1e3
    shown = re.search(r"\bW ([\d.]+)", words(run))
    assert shown is not None
    assert float(shown[1]) == pytest.approx(rate, rel=1e-2)
    assert ("data:image/png;base64," in run._repr_html_()) == (run.picture is not None)


def test_a_fit_names_its_parameters_as_pages_do(found):
    fit = found.fit("beverloo")
    assert fit.symbols["C_particle"] == "C (grain density)"
    assert fit.symbols.keys() == fit.parameters.keys()
    assert fit._repr_html_().count("<circle") == len(fit.D) == 4
    assert "band: 95 % interval of the law" in words(fit)
    assert {"C (grain density)", "k"} <= set(re.findall(r"<td>([^<]*)</td>", fit._repr_html_()))
    assert "C_particle, shown as C (grain density), = " in repr(fit)
    assert list(fit.frame()["symbol"]) == list(fit.symbols.values())
    assert repr(fit.law) == f"<beverloo: {fit.law.formula}>"


def test_a_parameter_that_the_data_do_not_determine_has_no_value(found):
    from dataclasses import replace

    fit = found.fit("beverloo")
    open_ended = replace(fit.parameters["k"], high=float("inf"))
    assert "not determined" in words(replace(fit, parameters={**fit.parameters, "k": open_ended}))
    assert words(fit).count("not determined") < words(
        replace(fit, parameters={**fit.parameters, "k": open_ended})
    ).count("not determined")


def test_points_traces_and_labs_have_a_display(found):
    result, trace = found.points[1], found.run(2).trace
    assert "D = 21 mm" in words(result)
    assert "2 finished" in words(result)
    assert "<svg" in found.study.points[1]._repr_html_()
    assert "orifice 21 mm" in words(found.study.points[1])
    assert "t [s] W [g/s] shaded: the window of the mean" in words(trace)
    drawn = [
        float(pair.split(",")[1]) for pair in re.findall(r'polyline points="([^"]*)"', trace._repr_html_())[0].split()
    ]
    heights = max(drawn) - np.array(drawn)  # pixels of SVG count downwards
    assert heights / heights.max() * np.ptp(trace.rate) == pytest.approx(
        trace.rate - trace.rate.min(), abs=2e-3 * trace.rate.max()
    )
    assert len(repr(trace)) < 200
    assert words(trace) in words(found.run(2))
    lab = labbook.Lab(found.lab_folder.folder, found.backend)
    assert "toy-study toy finished 8" in words(lab)
    assert "8 runs" in words(lab)


@pytest.mark.parametrize(("name", "element"), [("a.webp", "<img "), ("a.gif", "<img "), ("a.mp4", "<video ")])
def test_a_film_plays_in_a_notebook(name, element, tmp_path):
    content = b"a film"
    path = FilmPath(tmp_path / name)
    path.write_bytes(content)
    shown = path._repr_html_()
    assert shown.startswith(element)
    assert b64encode(content).decode() in shown
    assert isinstance(path, Path)


def test_what_people_wrote_is_text():
    assert "<b>" not in table(("<b>",), [("a ^(2)",)])
    assert "a <sup>2</sup>" in table(("x",), [("a ^(2)",)])


def test_flow_against_time_is_a_table_with_units(found):
    trace = found.run(2).trace
    table = trace.frame()
    assert list(table) == ["time", "flow_rate", "in_window"]
    assert table.attrs["units"] == {"time": "s", "flow_rate": "kg/s"}
    inside = table[table.in_window]
    assert 0 < len(inside) < len(table)
    assert trace.window[0] <= inside.time.min() <= inside.time.max() <= trace.window[1]
    with_none = type(trace)(trace.time, trace.rate, None)
    assert not with_none.frame().in_window.any()


@pytest.mark.slow
def test_a_result_shows_its_next_figure_where_the_first_has_nothing_to_show(found, monkeypatch):
    from labbook.report import gallery

    def nothing():
        raise gallery.NothingToShow("map: too few points")

    monkeypatch.setattr(
        gallery, "of_series", lambda results, series, of=gallery.of_series: {"first": nothing, **of(results, series)}
    )
    assert "data:image/png;base64," in found._repr_html_()
