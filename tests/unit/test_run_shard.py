"""Parts of a study: each run in one of them, the same whichever way, and book-keeping that grows as they do."""

import pytest
from labbook_toy import Backend
from toy_lab import arrays, carry_out, study, study_file
from typer.testing import CliRunner

from labbook.cli import build
from labbook.run.plan import Planner
from labbook.run.shard import WHOLE, Shard


def test_parts_in_labs_of_their_own_are_the_whole(tmp_path):
    asked = study(tmp_path, replicates=6)
    carry_out(asked, tmp_path / "whole")
    every = {path.name for path in (tmp_path / "whole/runs").iterdir()}
    found: list[str] = []
    for number in (1, 2, 3):
        lab = tmp_path / str(number)
        summary = carry_out(asked, lab, shard=Shard(number, 3))
        names = [path.name for path in (lab / "runs").iterdir()] if (lab / "runs").exists() else []
        assert summary.done == summary.asked == len(names)
        assert len(names) == 4
        found += names
        for name in names:
            assert arrays(lab / "runs" / name) == arrays(tmp_path / "whole/runs" / name)
    assert len(found) == len(every)
    assert set(found) == every


def test_parts_in_one_lab_make_it_complete(tmp_path):
    asked = study(tmp_path, replicates=6)
    for number in (2, 1):
        carry_out(asked, tmp_path / "lab", shard=Shard(number, 2))
    again = carry_out(asked, tmp_path / "lab")
    assert not again.tally.ran
    assert again.complete


def test_runs_from_one_packing_are_in_one_part_and_parts_are_even():
    scenes = [f"{(k * 0x9E3779B97F4A7C15) % 2**64:016x}" for k in range(1, 200)]
    for scene in scenes:
        assert [sum(Shard(number, 7).holds(scene, seed) for seed in range(1, 15)) for number in range(1, 8)] == 7 * [2]
    first = [sum(Shard(number, 4).holds(scene, 1) for scene in scenes) for number in range(1, 5)]
    assert min(first) > 25, "one seed each of many scenes is spread too"
    assert all(WHOLE.holds(scene, 1) for scene in scenes)


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "a/b", "1/0", "-1/2", "1/999999"])
def test_a_part_that_there_is_not_is_refused(text, tmp_path):
    given = ["run", str(study_file(tmp_path)), "--lab", str(tmp_path / "lab"), f"--shard={text}"]
    result = CliRunner().invoke(build(), given)
    assert result.exit_code == 1
    assert "write i/n" in result.output
    assert not (tmp_path / "lab").exists()


def test_a_run_that_is_done_is_looked_at_alone(tmp_path, monkeypatch):
    looked = []
    item = Planner._item
    monkeypatch.setattr(Planner, "_item", lambda self, demand: looked.append(demand.seed) or item(self, demand))
    summary = carry_out(study(tmp_path, replicates=6), tmp_path / "lab", backend=Backend(), lanes=1)
    assert summary.complete
    assert len(looked) <= 2 * summary.asked
