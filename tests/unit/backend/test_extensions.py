"""Extensions are held to what they must define when they are loaded; errors in their code are one message, and all
other results stand."""

import sys
from importlib import import_module, invalidate_caches
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from toy_lab import carry_out, labbook, study_file

from labbook import plugins
from labbook.backend import load as load_backend
from labbook.checks import doctor
from labbook.checks.verify.cases import EVERY, select_cases
from labbook.checks.verify.platform import Platform
from labbook.checks.verify.show import judge_all
from labbook.cli.options import explanation
from labbook.filling.placing import Start
from labbook.fit import LAWS, Law
from labbook.lab import Catalogue
from labbook.lab.provenance import provenance
from labbook.measure import MEASURES, Measure
from labbook.papers import Paper
from labbook.plugins import BrokenPlugin, Extension, ExtensionError, Registry, required
from labbook.report.paper import Drawing, figures_of_all
from labbook.results.find import find
from labbook.results.frames import frames
from labbook.scene.contact import CONTACT_LAWS, ContactLaw
from labbook.scene.model import TaggedModels
from labbook.scene.walls import WallShape
from labbook.study import load
from labbook.study.extensions import used_by_analysis, used_by_runs
from labbook.study.paper import PAPERS

HEAD = {
    "measure": "from labbook.measure import Measure, Evaluation, Quantity\n",
    "law": "import numpy as np\nfrom labbook.fit import Law\n",
    "paper": "from labbook.papers import Paper\n",
    "start": "from labbook.filling.placing import Start\n",
    "case": "from labbook.checks.verify.case import Case, limited\n",
    "contact": "from typing import ClassVar, Literal\nfrom labbook.scene.contact import ContactLaw\n",
}


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Writes a module of the package bed_extras; gives the module."""
    folder = tmp_path / "bed_extras"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(str(tmp_path))

    def make(name: str, text: str):
        (folder / f"{name}.py").write_text(HEAD[name] + text, encoding="utf-8")
        for module in [one for one in sys.modules if one.partition(".")[0] == "bed_extras"]:
            monkeypatch.delitem(sys.modules, module)
        invalidate_caches()
        return import_module(f"bed_extras.{name}")

    return make


@pytest.fixture
def put(write, monkeypatch):
    """Puts an object of the package into a registry, in place of what has its name there."""

    def place(registry, group: str, kind: str, text: str) -> None:
        entry = write(kind, text).Own()
        entries = {**registry, entry.name: entry}
        extension = Extension(group, entry.name, "bed-extras", "0.1", f"bed_extras.{kind}")
        monkeypatch.setitem(vars(registry), "_entries", (entries, {**registry.extensions, entry.name: extension}))
        monkeypatch.setitem(vars(registry), "_objects", entries)

    return place


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        (ContactLaw, {"physics", "usual_step", "honours", "stiffened", "damping_ratio", "collision_time", "stability"}),
        (WallShape, {"physics", "distance"}),
        (Start, {"name", "version", "volume", "place"}),
        (Measure, {"name", "version", "declared", "check", "probes", "evaluate"}),
        (Law, {"name", "version", "formula", "source", "free", "least_ratio", "log_flow", "start", "reported"}),
        (Paper, {"name"}),
    ],
)
def test_what_a_class_has_to_define_follows_from_its_base(kind, names):
    assert names <= set(required(kind))


@pytest.mark.parametrize(
    ("registry", "text", "missing"),
    [
        (
            Registry("labbook.starts", Start, ()),
            "class Own(Start):\n    name = 'own'\n    def volume(self, closed): ...\n",
            "it lacks version, place; define that in Own",
        ),
        (
            TaggedModels("law", "labbook.contact_laws", ContactLaw, ()),
            "class Own(ContactLaw):\n"
            "    physics: ClassVar[str] = __name__\n    usual_step: ClassVar[str] = '0.02 collision'\n"
            "    honours: ClassVar[frozenset[str]] = frozenset()\n    law: Literal['own'] = 'own'\n"
            "    def stability(self, rods): ...\n    def damping_ratio(self, e): ...\n"
            "    def collision_time(self, mass, radius, speed): ...\n",
            "stiffened",
        ),
    ],
)
def test_missing_names_are_told_in_one_line_when_an_entry_is_loaded(write, monkeypatch, registry, text, missing):
    kind = "start" if registry._group == "labbook.starts" else "contact"
    write(kind, text)
    entry = EntryPoint("own", f"bed_extras.{kind}:Own", registry._group)
    vars(entry)["dist"] = SimpleNamespace(name="bed-extras", version="0.1")
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry])
    with pytest.raises(BrokenPlugin) as raised:
        dict(registry)
    line = str(raised.value)
    assert line.startswith(f"bed_extras.{kind}:Own of bed-extras, announced in {registry._group}: it lacks ")
    assert missing in line
    assert "\n" not in line


def test_errors_of_labbooks_own_objects_stay_as_they_are():
    with pytest.raises(AttributeError, match="of labbook"), MEASURES.calling("flow_rate"):
        raise AttributeError("of labbook")


SIZES = {"count": 400, "orifices": "[18, 21, 24, 30]", "replicates": 2}


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> Path:
    """A folder with a study of four orifices and its lab, without the measure `packing`."""
    folder = tmp_path_factory.mktemp("done")
    carry_out(load(study_file(folder, **SIZES)), folder / "lab")
    return folder


def results(done, *more: str):
    path = study_file(done, *more, **SIZES)
    path.write_text(path.read_text().replace("[flow_rate]", "[flow_rate, packing]"))
    return find(load(path), Catalogue(done / "lab"), "toy")


MEASURE = """
class Own(Measure):
    name, version, declared = "packing", 90, (Quantity("packing_fraction", "phi"),)
    def check(self, scene): ...
    def probes(self, scene, numerics): return ()
    def evaluate(self, run, window):
        return Evaluation(run.nothing)
"""


@pytest.mark.slow
def test_a_measure_that_fails_is_named_and_tried_again_after_its_author_has_corrected_it(done, put):
    put(MEASURES, "labbook.measures", "measure", MEASURE)
    found = results(done)
    assert all(point.flow_rate for point in found.points), "other numbers stand"
    assert len(found.unmeasured) == 8
    (why,) = {line.partition("packing: ")[2] for line in found.unmeasured}
    assert why == (
        "measure packing of bed-extras 0.1: AttributeError: 'RunData' object has no attribute 'nothing' "
        "(bed_extras/measure.py, line 8)"
    )
    put(MEASURES, "labbook.measures", "measure", MEASURE.replace("run.nothing", ""))
    assert not results(done).unmeasured, "a failure is not kept"


LAW = """
class Own(Law):
    name, version, formula, source, free = "power", 1, "W = 1", "nobody", ("a",)
    least_ratio = 1.0
    def log_flow(self, D, free, context): return 0 * D
    def start(self, D, W, context): return np.zeros(1)
    def reported(self, context): return ()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("right", "wrong", "why"),
    [
        (
            "return np.zeros(1)",
            "return nothing",
            "flow law power of bed-extras 0.1: NameError: name 'nothing' is not defined (bed_extras/law.py, line 8)",
        ),
        ("0 * D", "np.nan * D", "log_flow gives NaN"),
    ],
)
def test_a_flow_law_that_fails_is_named_and_other_laws_are_fitted(done, put, right, wrong, why):
    put(LAWS, "labbook.laws", "law", LAW.replace(right, wrong))
    (series,) = results(done, "fit: [power, beverloo]").series
    assert "beverloo" in series.fits
    (problem,) = series.problems
    assert why in problem
    assert [one.use for one in used_by_analysis(load(done / "toy.yaml"))] == ["flow law power"]


PAPER = """
class Own(Paper):
    name, heads = "bed2026", ("bed",)
    fits = {"bed": "flow_rate"}
    def fit(self, name, points): raise KeyError("fit")
    def unit(self, quantity, asked): return ""  if quantity.startswith("bed.") else None
    def compared(self, results, quantity, at): raise KeyError("compared")
    def judged(self, results, statement): raise KeyError("judged")
    def frames(self, results): return {"beds": (row for row in results.nothing)}
    def sections(self, results, folder): raise KeyError("sections")
    def of_series(self, results, series, folder, suffix, where): raise KeyError("of_series")
    def tables(self, results, series, where): raise KeyError("tables")
    def figures(self, results): return {"beds": lambda: results.nothing}
    def figures_of(self, results, series): raise KeyError("figures_of")
    def shows_beds_of(self, results): raise KeyError("shows_beds_of")
"""
STATED = (
    "fit: [beverloo, bed]",
    "reference:",
    "  source: a paper",
    "  flow_rate: {value: 40 g/s}",
    "  bed.depth: {value: 2}",
    "  bed.order: {from: 1, says: beds are deep}",
)


@pytest.mark.slow
def test_a_paper_whose_code_fails_everywhere_leaves_all_other_results(done, put):
    put(PAPERS, "labbook.papers", "paper", PAPER)
    of = "paper bed2026 of bed-extras 0.1: KeyError: "
    found = results(done, *STATED)
    (series,) = found.series
    assert "beverloo" in series.fits
    assert f"{of}'fit' (bed_extras/paper.py, line 6)" in series.problems[0]
    by_quantity = {one.quantity: one for one in found.comparisons}
    assert f"{of}'compared'" in by_quantity["bed.depth"].why
    assert by_quantity["flow_rate"].ours, "labbook's own quantities are compared"
    (judged,) = found.judged
    assert judged.verdict == "undecided"
    assert f"{of}'judged'" in judged.why
    tables = frames(found)
    assert "beds" not in tables
    assert any("has no attribute 'nothing'" in why for why in tables["problems"]["why"])
    with pytest.raises(ExtensionError, match="paper bed2026 of bed-extras"):
        figures_of_all(found)["beds"]()
    with pytest.raises(ExtensionError, match="figures_of"):
        figures_of_all(found, series)["bed2026"]()
    there = (done / "toy.yaml", "--lab", done / "lab", "--backend", "toy")
    shown = labbook("fit", *there)
    assert f"Not shown: {of}'tables'" in shown.output
    assert "Beverloo" in shown.output
    labbook("report", *there)
    page = (done / "lab/reports/toy-study/report.html").read_text(encoding="utf-8")
    for text in ("sections", "of_series", "Analysis of bed2026", "analysis: paper bed2026", "bed-extras 0.1"):
        assert text in page


def test_an_error_that_nothing_catches_is_told_by_the_extension_whose_line_raised_it(write, monkeypatch):
    module = write("law", "def start(x):\n    return x.nothing\n")
    monkeypatch.setitem(
        plugins._loaded, "bed_extras", [Extension("labbook.laws", "own", "bed-extras", "0.1", "bed_extras.law")]
    )
    with pytest.raises(AttributeError) as raised:
        module.start(1)
    assert explanation(raised.value) == (
        "flow law own of bed-extras 0.1: AttributeError: 'int' object has no attribute 'nothing' "
        "(bed_extras/law.py, line 4)"
    )
    with pytest.raises(AttributeError) as raised:
        _ = (1).nothing  # pyright: ignore[reportAttributeAccessIssue]
    assert explanation(raised.value) is None, "an error of labbook has its traceback"


def test_runs_name_the_extensions_that_they_use_and_no_other(done, monkeypatch):
    (point, *_) = load(study_file(done)).points
    for registry, name in ((CONTACT_LAWS, "hertz-mindlin"), (CONTACT_LAWS, "linear")):
        extension = Extension("labbook.contact_laws", name, f"{name}-extras", "0.1", "bed_extras")
        monkeypatch.setitem(registry.extensions, name, extension)
    used = used_by_runs(point, "numba")
    origin = provenance("cpu", used)
    assert origin["extensions"] == {"contact law hertz-mindlin": "hertz-mindlin-extras 0.1"}
    assert origin["packages"]["hertz-mindlin-extras"] == "0.1"
    assert "linear-extras" not in origin["packages"]
    assert "extensions" not in provenance("cpu")


def test_the_doctor_lists_what_each_package_adds(monkeypatch):
    extensions = [
        Extension(group, name, "bed-extras", "0.1", "bed_extras")
        for group, name in (("labbook.contact_laws", "viscous"), ("labbook.cases", "rebound"))
    ]
    monkeypatch.setattr(doctor, "extensions", lambda: extensions)
    monkeypatch.setattr(doctor, "installed", dict)
    (package,) = [package for package in doctor.examine().packages if package.name == "bed-extras"]
    assert package == doctor.Package("bed-extras", "0.1", "adds contact law viscous, case rebound")


CASE = """
def run(stand): return stand.nothing

class Own(Case):
    def __init__(self):
        super().__init__("rebound", "it rebounds", "nobody", {"speed": limited(1e-3)}, run)
"""


def test_a_case_that_fails_to_run_is_a_failed_verdict_with_the_reason(put):
    put(EVERY, "labbook.cases", "case", CASE)
    assert [case.name for case in select_cases(["rebound"])] == ["rebound"]
    (verdict,) = judge_all(select_cases(["rebound"]), Platform(load_backend("reference")))
    assert verdict.result == "failed"
    assert verdict.note.startswith("case rebound of bed-extras 0.1: AttributeError: 'Platform' object has no attribute")
    assert verdict.note.endswith("(bed_extras/case.py, line 3)")


def test_a_figure_of_a_paper_keeps_its_caption(monkeypatch):
    class Bed2026(Paper):
        name = "bed2026"

        def figures(self, results) -> Any:
            drawn: Any = results
            return {"beds": Drawing(lambda: drawn, lambda: "Beds.", "points"), "plain": lambda: drawn}

    monkeypatch.setattr("labbook.report.paper.papers", lambda: [Bed2026()])
    figures = figures_of_all("results")  # pyright: ignore[reportArgumentType]
    beds = figures["beds"]
    assert isinstance(beds, Drawing)
    assert (beds(), beds.caption(), beds.table) == ("results", "Beds.", "points")
    assert figures["plain"]() == "results"
