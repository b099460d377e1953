"""A package from outside adds a measure, a law and a backend; nothing in labbook knows of it."""

import json
import os
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from toy_lab import ROOT, study_file

from labbook import plugins
from labbook.cli.options import told
from labbook.fit import LAWS, Law
from labbook.plugins import BrokenPlugin, Registry

OUTSIDE = ROOT / "tests/toy/outside"


def labbook(*words: object) -> subprocess.CompletedProcess[str]:
    """`labbook WORDS` in a process that has the package installed."""
    folders = [OUTSIDE, ROOT, ROOT / "backends", ROOT / "tests/toy"]
    given = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders))}
    command = [sys.executable, "-c", "from labbook.cli import main; main()", *map(str, words)]
    return subprocess.run(command, env=given, capture_output=True, text=True)


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("outside")
    more = (
        "fit: [straight, beverloo]",
        "reference: {source: a paper, half_time: {value: 200 ms}, straight.c: {value: 3 mm}}",
    )
    path = study_file(folder, *more, orifices="[15, 18, 21, 24]")
    path.write_text(path.read_text().replace("[flow_rate]", "[flow_rate, half_time]"))
    return path


@pytest.mark.slow
def test_they_go_through_every_verb(study):
    there = ("--lab", study.parent / "lab", "--backend", "hourglass")
    for verb in (("run",), ("report",), ("export",)):
        ended = labbook(*verb, study, *there)
        assert ended.returncode == 0, ended.stderr
    found = json.loads(labbook("fit", study, *there, "--json").stdout)
    halves = [row["value"] for row in found["points"] if row["quantity"] == "half_time"]
    assert halves == sorted(halves, reverse=True)
    assert len(halves) == 4
    fitted = {(row["law"], row["parameter"]) for row in found["fits"]}
    assert {("straight", "S"), ("straight", "c"), ("beverloo", "k")} <= fitted
    assert {row["quantity"]: row["ours"] is not None for row in found["reference"]} == {
        "half_time": True,
        "straight.c": True,
    }
    shown = labbook("fit", study, *there).stdout
    assert "t½" in shown
    assert "S [g/(s mm)]" in shown
    page = (study.parent / "lab/reports/toy-study/report.html").read_text(encoding="utf-8")
    assert "t½" in page
    assert "W = S (D - c)" in page or "straight" in page.lower()


def test_without_the_package_the_study_says_what_is_not_known(study):
    words = ("-c", "from labbook.cli import main; main()", "plan", str(study), "--lab", str(study.parent / "none"))
    ended = subprocess.run([sys.executable, *words], capture_output=True, text=True)
    assert ended.returncode == 1
    assert "half_time" in ended.stderr
    assert "straight" in ended.stderr


@pytest.mark.parametrize(
    ("value", "why"),
    [
        ("silo_nothing:Law", "cannot be loaded (ModuleNotFoundError"),
        ("labbook.fit:fit", "it is no Law"),
        ("labbook.fit:Power", "power is there already"),
    ],
)
def test_what_is_broken_is_named_with_a_remedy(monkeypatch, value, why):
    entry = EntryPoint("power", value, "labbook.laws")
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry] if group == "labbook.laws" else [])
    registry = Registry[Law]("labbook.laws", Law, LAWS.values())
    with pytest.raises(BrokenPlugin, match="uninstall") as raised:
        dict(registry)
    assert why in str(raised.value)
    assert value in str(raised.value)
    assert told(raised.value) == str(raised.value), "every verb ends with this line"
