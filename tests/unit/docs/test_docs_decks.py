"""The studies after public decks: each is planned, and stands on its page with what it shows."""

import re
from pathlib import Path

import pytest

from labbook.api import Lab
from labbook.scene import LinearSpringDashpot, Spheres
from labbook.study import load

ROOT = Path(__file__).parents[3]
FOLDER, PAGE = ROOT / "studies/decks", ROOT / "docs/decks.md"
STUDIES = sorted(FOLDER.glob("*.yaml"))


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_a_study_after_a_deck_is_planned(path, tmp_path):
    study = load(path)
    assert study.name == path.stem
    plan = Lab(tmp_path / "lab", "reference").plan(study)
    assert plan.counts()["missing"] == 1
    lines = plan.lines()
    grains, law = study.points[0].scene.grains, study.points[0].scene.contact
    assert any(line.startswith("Sizes:") for line in lines) == (isinstance(grains, Spheres) and grains.graded)
    stated = isinstance(law, LinearSpringDashpot) and (law.contact_time or law.largest_overlap) is not None
    assert any(line.startswith("Stiffness:") for line in lines) == stated


def test_the_page_has_every_study_and_no_other():
    named = re.findall(r"\[([a-z-]+)\]\(\.\./studies/decks/\1\.yaml\)", PAGE.read_text(encoding="utf-8"))
    assert sorted(named) == [path.stem for path in STUDIES]
