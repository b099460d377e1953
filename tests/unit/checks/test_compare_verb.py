"""`labbook compare`."""

import json
import signal
import time

import pytest
from toy_lab import labbook, start
from toy_pair import study_file

BIAS = 0.07


@pytest.mark.slow
def test_the_verb_from_nothing_to_a_stale_verdict(tmp_path):
    path, lab = study_file(tmp_path), tmp_path / "lab"
    words = ("compare", path, "--lab", lab, "--backends", "toy,twin")
    missing = labbook(*words, "--show", check=False)
    assert missing.exit_code == 1
    assert "labbook compare" in missing.stderr
    done = labbook(*words)
    assert "equivalent within 3 % in all 4 tests" in done.stdout
    assert "orifice 24 mm" in done.stdout
    kept = {file.suffix for file in (lab / "compare/toy-study").iterdir()}
    assert {".json", ".png", ".svg"} <= kept
    shown = labbook(*words, "--show").stdout
    assert "STALE" not in shown
    later = json.loads(labbook(*words, "--show", "--json", LABBOOK_TWIN_VERSION="2").stdout)
    assert later["finding"] == "equivalent"
    assert later["stale"] == ["twin was at version 1 and is now at 2"]
    assert "STALE: twin was at version 1" in labbook(*words, "--show", LABBOOK_TWIN_VERSION="2").stdout
    biased = labbook(*words, "--replicates", 4, LABBOOK_TWIN_VERSION="3", LABBOOK_TOY_BIAS=str(BIAS), check=False)
    assert biased.exit_code == 1
    assert "DIFFERENT by more than 3 %" in biased.stdout


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--devices", "cpu,cuda:0"), "the toy backend has no cuda:0"),
        (("--backends", "toy,nobody"), "no backend is called nobody"),
        (("--point", "9"), "has the points 1 to 2"),
        (("--precisions", "double,half"), "no precision is called half"),
        (("--show", "--backends", "toy,toy"), "compared with itself"),
        (
            ("--show", "--backends", "toy,toy", "--precisions", "double,mixed"),
            "toy,toy --precisions double,mixed",
        ),
        (("--show", "--backends", "toy"), "two names separated by a comma"),
    ],
)
def test_mistakes_are_told_in_a_line(tmp_path, more, said):
    ended = labbook(
        "compare", study_file(tmp_path), "--lab", tmp_path / "lab", "--backends", "toy,twin", *more, check=False
    )
    assert ended.exit_code == 1
    assert said in ended.stderr


@pytest.mark.slow
def test_what_was_stopped_goes_on(tmp_path):
    path, lab = study_file(tmp_path), tmp_path / "lab"
    words = ("compare", path, "--lab", lab, "--backends", "toy,twin")
    process = start(*words, delay=0.02)
    deadline = time.monotonic() + 60
    while not list((lab / "work").glob("*.lock")):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Stopped early" in said
    assert not (lab / "compare").exists()
    assert "in all 4 tests" in labbook(*words).stdout
