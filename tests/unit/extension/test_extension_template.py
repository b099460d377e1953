"""The package that `labbook new-extension` writes installs, and its law, measure, case and tests work as they are."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from toy_lab import ROOT, labbook

from labbook.extension import PackageNotWritten, write


@pytest.mark.parametrize("name", ["Bed", "bed_extras", "1bed", "bed--extras", "class", "json", "labbook-extras", ""])
def test_names_that_no_package_can_have_are_refused(tmp_path, name):
    with pytest.raises(PackageNotWritten):
        write(name, tmp_path)
    assert not list(tmp_path.iterdir())


def test_what_is_there_is_left_as_it_is(tmp_path):
    labbook("new-extension", "bed-extras", "--folder", tmp_path)
    (tmp_path / "bed-extras/bed_extras/viscous.py").write_text("mine", encoding="utf-8")
    again = labbook("new-extension", "bed-extras", "--folder", tmp_path, check=False)
    assert again.exit_code == 1
    assert "exists and is left as it is" in again.stderr
    assert (tmp_path / "bed-extras/bed_extras/viscous.py").read_text() == "mine"
    assert "no such" in labbook("new-extension", "b", "--folder", tmp_path / "none", check=False).stderr.lower()


def test_nothing_of_the_template_keeps_its_name(tmp_path):
    for path in write("bed-extras", tmp_path).rglob("*"):
        assert "my_extension" not in path.name
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        assert "my-extension" not in text.replace("_", "-")


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    """The folder of such a package, installed into its folder `site`."""
    folder = write("bed-extras", tmp_path_factory.mktemp("written"))
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", str(folder / "site"), str(folder)], check=True, capture_output=True)
    return folder


def process(package: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """`python WORDS` with the package, and with the toy backend under the name `hourglass`."""
    paths = [package / "site", ROOT, ROOT / "backends", ROOT / "tests/toy", ROOT / "tests/toy/outside"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths))}
    command = [sys.executable, *map(str, words)]
    return subprocess.run(command, env=environment, cwd=package.parent, capture_output=True, text=True)


MAIN = "from labbook.cli import main; main()"


@pytest.mark.slow
def test_its_tests_and_its_case_pass(package):
    tests = package / "site/bed_extras"
    code = f"import pytest; assert not pytest.main(['-q', '-p', 'no:cacheprovider', {str(tests)!r}]); {MAIN}"
    ended = process(package, "-c", code, "verify", "viscous", "--backend", "reference", "--json")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    verdicts = json.loads(ended.stdout[ended.stdout.index("\n[") :])
    assert [(one["case"], one["result"]) for one in verdicts] == [("viscous-restitution", "passed")]


@pytest.mark.ring
def test_its_study_runs_and_is_stale_after_an_edit_of_the_law(package):
    """In parts: tests/unit/lab/test_extension_source.py."""
    there = (package / "study.yaml", "--backend", "hourglass", "--json")
    law = package / "site/bed_extras/viscous.py"

    def reasons() -> set[tuple[str, str]]:
        ended = process(package, "-c", MAIN, "plan", *there)
        assert ended.returncode == 0, ended.stderr
        return {(run["state"], run["reason"]) for run in json.loads(ended.stdout)["runs"]}

    ended = process(package, "-c", MAIN, "run", *there[:-1])
    assert ended.returncode == 0, ended.stderr
    formulas = law.read_text(encoding="utf-8")
    law.write_text(formulas.replace("There is no friction spring.", "Friction has no spring."), encoding="utf-8")
    assert {state for state, _ in reasons()} == {"done"}
    law.write_text(formulas.replace("s * real(0.0)", "s"), encoding="utf-8")
    assert reasons() == {("stale", "the law viscous of bed-extras has changed since")}
    (folder, *_) = (package.parent / "lab/runs").iterdir()
    used = json.loads((folder / "run.json").read_text())["sessions"][-1]["provenance"]["extensions"]
    assert used == {"contact law viscous": "bed-extras 0.1", "backend hourglass": "silo-extras 1"}
