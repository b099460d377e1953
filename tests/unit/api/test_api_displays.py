"""What a notebook shows of labs, points, runs, traces and fits."""

import re
from html.parser import HTMLParser

import pytest
from toy_lab import study

import labbook
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
    assert f"0 to {trace.rate.max() * 1e3:.4g} g/s" in words(trace)
    assert len(repr(trace)) < 200
    assert words(trace) in words(found.run(2))
    lab = labbook.Lab(found.place.folder, found.backend)
    assert "toy-study toy finished 8" in words(lab)
    assert "8 runs" in words(lab)


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
        gallery, "of_series", lambda results, series, of=gallery.of_series: {"map": nothing, **of(results, series)}
    )
    assert "data:image/png;base64," in found._repr_html_()
