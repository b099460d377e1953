"""A strategy of another package, in a study file: planned, run, killed and resumed, shared by processes, reported."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from toy_lab import ROOT, study_file

FOLDERS = [ROOT / "tests/toy/outside", ROOT, ROOT / "backends", ROOT / "tests/toy"]
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, FOLDERS))}
LABBOOK = [sys.executable, "-c", "from labbook.cli import main; main()"]
# what the toy gives at an outlet of 20 mm: 0.6 rho sqrt(g) (D - 1.4 d)^1.5 over the depth is 28 g/s
WANTED = "28 g/s"


def labbook(*words: object, delay: float = 0.0) -> subprocess.CompletedProcess[str]:
    environment = {**ENVIRONMENT, "LABBOOK_TOY_DELAY": str(delay)}
    return subprocess.run([*LABBOOK, *map(str, words)], env=environment, capture_output=True, text=True)


def begun(*words: object, delay: float) -> subprocess.Popen:
    environment = {**ENVIRONMENT, "LABBOOK_TOY_DELAY": str(delay)}
    return subprocess.Popen([*LABBOOK, *map(str, words)], env=environment, stdout=subprocess.DEVNULL)


def asked(folder: Path, adapt: str = f"{{bisect: {{flow_rate: {WANTED}, within: 0.04}}}}") -> Path:
    return study_file(folder, f"adapt: {adapt}", "window: {start: 0.15, end: 0.6}", orifices="[15, 30]")


def proposals(lab: Path) -> dict:
    (file,) = (lab / "campaigns").glob("*.json")
    return json.loads(file.read_text())


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> tuple[Path, Path]:
    """A study and the lab in which its campaign has ended."""
    folder = tmp_path_factory.mktemp("whole")
    path = asked(folder)
    ended = labbook("run", path, "--lab", folder / "lab", "--backend", "toy")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return path, folder / "lab"


@pytest.mark.slow
def test_it_finds_the_outlet_and_says_why(whole):
    path, lab = whole
    record = proposals(lab)
    assert record["strategy"] == "bisect"
    assert record["ended"] is not None
    assert "the ends of the range, 15 and 30 mm" in record["generations"][0]["reason"]
    # every later generation is the middle of what is left: it halves until within 4 %
    outlets = [one["at"]["container.orifice"] for step in record["generations"] for one in step["assignments"]]
    assert outlets[:3] == pytest.approx([0.015, 0.030, 0.0225])
    assert abs(outlets[-1] - outlets[-2]) < 0.04 * outlets[-1]
    planned = labbook("plan", path, "--lab", lab, "--backend", "toy").stdout
    assert "Generation 1 of bisect: the ends of the range" in planned
    assert "bisect has ended: the outlet lies between" in planned
    page = labbook("report", path, "--lab", lab, "--backend", "toy")
    assert page.returncode == 0, page.stderr
    assert "bisect has ended" in (lab / "reports/toy-study/report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_plan_proposes_but_keeps_nothing(tmp_path):
    path = asked(tmp_path)
    planned = labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy")
    assert planned.returncode == 0, planned.stderr
    assert "4 missing" in planned.stdout, "two ends of two replicates"
    assert not (tmp_path / "lab/campaigns").exists()


@pytest.mark.ring
@pytest.mark.slow
def test_killed_again_and_again_it_proposes_the_same_and_repeats_no_run(tmp_path, whole):
    path, lab = asked(tmp_path), tmp_path / "lab"
    written: dict[str, int] = {}
    for _ in range(4):
        process = begun("run", path, "--lab", lab, "--backend", "toy", delay=0.01)
        runs = len(list((lab / "runs").glob("*"))) if lab.exists() else 0
        deadline = time.monotonic() + 60
        while process.poll() is None and len(list((lab / "runs").glob("*"))) < runs + 2:
            assert time.monotonic() < deadline, "no two runs are done in a minute"
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
        process.wait()
        for folder in (lab / "runs").glob("*"):
            made = (folder / "run.json").stat().st_mtime_ns
            assert written.setdefault(folder.name, made) == made, "a finished run is not made again"
    ended = labbook("run", path, "--lab", lab, "--backend", "toy")
    assert ended.returncode == 0, ended.stderr
    assert proposals(lab)["generations"] == proposals(whole[1])["generations"]
    assert {one.name for one in (lab / "runs").glob("*")} == {one.name for one in (whole[1] / "runs").glob("*")}
    assert all((lab / "runs" / name / "run.json").stat().st_mtime_ns == made for name, made in written.items())


@pytest.mark.slow
def test_two_processes_share_one_campaign(tmp_path, whole):
    path, lab = asked(tmp_path), tmp_path / "lab"
    both = [begun("run", path, "--lab", lab, "--backend", "toy", delay=0.002) for _ in range(2)]
    assert [process.wait(120) for process in both] == [0, 0]
    assert proposals(lab)["generations"] == proposals(whole[1])["generations"]


@pytest.mark.ring  # two processes above share it in the same way
def test_several_devices_share_one_campaign(tmp_path, whole):
    path, lab = asked(tmp_path), tmp_path / "lab"
    environment = {**ENVIRONMENT, "LABBOOK_TOY_DEVICES": "gpu:0,gpu:1"}
    there = ("--lab", lab, "--backend", "toy", "--device", "gpu:0,gpu:1")
    words = [*LABBOOK, "run", *map(str, (path, *there))]
    ended = subprocess.run(words, env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert proposals(lab)["generations"] == proposals(whole[1])["generations"]
    assert proposals(lab)["ended"] is not None


@pytest.mark.slow
def test_a_lab_without_the_file_proposes_the_same_and_runs_nothing(tmp_path, whole):
    path, lab = whole
    kept = proposals(lab)
    (file,) = (lab / "campaigns").glob("*.json")
    file.rename(tmp_path / "kept.json")
    planned = labbook("plan", path, "--lab", lab, "--backend", "toy")
    assert "bisect has ended" in planned.stdout, "all follows from the runs that are there"
    assert not list((lab / "campaigns").glob("*.json"))
    ended = labbook("run", path, "--lab", lab, "--backend", "toy")
    assert ended.returncode == 0, ended.stderr
    assert "now:" not in ended.stdout, "no run was made"
    assert proposals(lab) == kept


@pytest.mark.slow
@pytest.mark.parametrize(("adapt", "says"), [
    ("{bisect: {flow_rate: 24 mm}}", "adapt.bisect.flow_rate: 24 mm: a quantity in kg/s is needed"),
    ("{bisect: {flow_rate: 24 g/s, width: 3}}", "adapt.bisect.width: unknown key"),
    ("{bissect: {flow_rate: 24 g/s}}", "did you mean bisect?"),
    ("{}", "0 strategies are named, and one is needed"),
])  # fmt: skip
def test_what_is_wrong_is_said_with_file_and_line(tmp_path, adapt, says):
    path = asked(tmp_path, adapt)
    ended = labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy")
    assert ended.returncode == 1
    assert says in ended.stderr
    assert f"{path}:" in ended.stderr


@pytest.mark.slow
def test_parts_and_bases_are_refused(tmp_path):
    path = asked(tmp_path)
    for option in (("--shard", "1/2"), ("--base", tmp_path / "other")):
        ended = labbook("run", path, "--lab", tmp_path / "lab", "--backend", "toy", *option)
        assert ended.returncode == 1
        assert "adapt" in ended.stderr
    assert not list((tmp_path / "lab/runs").glob("*"))
