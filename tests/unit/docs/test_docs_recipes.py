"""Recipes of docs/howto.md, run line by line: on the toy backend, with fewer grains."""

import re
import shlex
from pathlib import Path

import pytest
from toy_lab import labbook

ROOT = Path(__file__).parents[3]
NUMERICS = "numerics: {dt: 10 us, steps_per_beat: 200, precision: double}\n"


def recipe(title: str) -> list[list[str]]:
    """Words of each `labbook` line in the section of this title, without the comment at its end."""
    text = (ROOT / "docs/howto.md").read_text(encoding="utf-8")
    section = re.split(r"^## ", text.split(f"## {title}\n")[1], flags=re.MULTILINE)[0]
    lines = [line for block in re.findall(r"```sh\n(.*?)```", section, re.DOTALL) for line in block.splitlines()]
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("labbook ")]


@pytest.mark.slow
def test_recipes_of_mixtures_and_residence_give_what_they_promise(tmp_path, monkeypatch):
    """The second continues the first, with the same study."""
    commands = [*recipe("Follow the kinds of a mixture"), *recipe("See from where grains leave first")]
    (tmp_path / "studies").mkdir()
    for study in {words[1] for words in commands}:
        text = (ROOT / study).read_text(encoding="utf-8").replace("replicates: 3", "replicates: 1") + NUMERICS
        (tmp_path / study).write_text(re.sub(r"count: \d+", "count: 800", text), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for words in commands:
        labbook(*words, "--backend", "toy")
    report, tables = tmp_path / "lab/reports/mixture-cone", tmp_path / "residence"
    promised = [report / "composition.png", report / "residence-map.png", tmp_path / "mixture/composition.csv"]
    promised += [tables / "residence.csv", tables / "layers.csv"]
    assert [path for path in promised if not path.exists()] == []
    page = (report / "report.html").read_text(encoding="utf-8")
    for words in ("Composition of the outflow", "mass in the bed [%]", "Residence times", "first in, first out"):
        assert words in page
