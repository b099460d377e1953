"""docs/tutorial.ipynb does what it says: its cells are run here, on the toy backend and, smaller, on the CPU."""

import ast
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
CELLS = json.loads((ROOT / "docs/tutorial.ipynb").read_text(encoding="utf-8"))["cells"]
SHOWN = ("_repr_html_", "_repr_svg_", "_repr_png_")


def code() -> list[str]:
    return ["".join(cell["source"]) for cell in CELLS if cell["cell_type"] == "code"]


def carried_out(changes: dict[str, str], folder: Path, monkeypatch) -> dict:
    """The names that the cells leave behind, after `changes` to their text; what a notebook shows is drawn, too."""
    import matplotlib

    matplotlib.use("Agg")
    monkeypatch.chdir(folder)
    names: dict = {}
    text = code()
    for old, new in changes.items():
        assert any(old in cell for cell in text), old
        text = [cell.replace(old, new) for cell in text]
    for cell in text:
        *first, last = ast.parse(cell).body
        exec(compile(ast.Module(first, []), "<cell>", "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "<cell>", "eval"), names)
            assert repr(value)
            for shown in SHOWN:
                getattr(value, shown, lambda: None)()
        else:
            exec(compile(ast.Module([last], []), "<cell>", "exec"), names)
    return names


def hold(names: dict, folder: Path, runs: int) -> None:
    """What a reader is told: everything is run, the flow grows with the outlet, nothing is computed twice."""
    results = names["results"]
    assert len(results.runs) == runs
    assert results.frame()["flow_rate"].is_monotonic_increasing
    assert set(names["lab"].plan(names["both"]).counts()) == {"done", "missing"}
    assert (folder / "lab/reports/first-silo/report.html").stat().st_size > 10_000
    assert (folder / "flow.pdf").read_bytes().startswith(b"%PDF")
    assert names["paths"].x.shape == (len(names["paths"].time), len(names["paths"].ids), 3)


@pytest.mark.slow
def test_the_tutorial_holds_on_the_toy_backend(tmp_path, monkeypatch, one_format):
    names = carried_out({'labbook.Lab("lab")': 'labbook.Lab("lab", "toy")'}, tmp_path, monkeypatch)
    hold(names, tmp_path, runs=16)


@pytest.mark.compiles
@pytest.mark.ring
def test_the_tutorial_holds_on_the_cpu(tmp_path, monkeypatch, one_format):
    smaller = {'"count": 1000': '"count": 500', "replicates=4": "replicates=2"}
    names = carried_out(smaller, tmp_path, monkeypatch)
    hold(names, tmp_path, runs=8)
    assert names["row"].sum() > 3, "there are grains in the row whose paths are drawn"
    k = names["beverloo"].parameters["k"]
    assert 0 < k.value < 3


def test_the_tutorial_was_run_and_is_small():
    assert (ROOT / "docs/tutorial.ipynb").stat().st_size < 700_000  # of which the film is a third
    for cell in CELLS:
        if cell["cell_type"] == "code":
            assert cell["execution_count"]
            assert not any(output["output_type"] == "error" for output in cell["outputs"])
