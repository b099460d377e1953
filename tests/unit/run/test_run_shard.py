"""Parts of a study: each run in one of them, the same whichever way, and book-keeping that grows as they do."""

import pytest
from labbook_toy import Backend
from toy_lab import arrays, carry_out, labbook, study, study_file
from typer.testing import CliRunner

from labbook.cli import build
from labbook.plan.demand import PointDemand, demands
from labbook.plan.forecast import discharge_work, fill_work
from labbook.plan.plan import Planner
from labbook.run.shard import Shard, WorkPartition
from labbook.study import load

CAN = Backend().capabilities


def test_parts_in_labs_of_their_own_are_the_whole(tmp_path):
    asked = study(tmp_path, replicates=6)
    carry_out(asked, tmp_path / "whole")
    every = {path.name for path in (tmp_path / "whole/runs").iterdir()}
    found: list[str] = []
    for number in (1, 2, 3):
        lab = tmp_path / str(number)
        summary = carry_out(asked, lab, shard=Shard(number, 3))
        names = [path.name for path in (lab / "runs").iterdir()] if (lab / "runs").exists() else []
        assert summary.done == summary.requested == len(names)
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


def test_parts_in_labs_of_their_own_become_the_whole_by_import(tmp_path):
    path = study_file(tmp_path, "record: {every: 5 ms, replicates: 1}", replicates=5, orifices="[18, 21, 24]")
    labbook("run", path, "--lab", tmp_path / "whole", "--backend", "toy")
    for number in range(1, 7):
        labbook("run", path, "--lab", tmp_path / str(number), "--backend", "toy", "--shard", f"{number}/6")
    assert not (tmp_path / "6/runs").exists(), "five packings are not divided into six parts"
    labbook("import", *(tmp_path / str(number) for number in (3, 1, 6, 4, 2, 5)), "--lab", tmp_path / "joined")
    assert not carry_out(load(path), tmp_path / "joined").tally.ran, "nothing is left to do"
    for kind in ("runs", "packings"):
        whole = sorted((tmp_path / "whole" / kind).iterdir())
        assert [one.name for one in whole] == sorted(one.name for one in (tmp_path / "joined" / kind).iterdir())
        for one in whole:
            assert arrays(tmp_path / "joined" / kind / one.name) == arrays(one)


def parts(asked, of, seeds):
    """Of each run of a study, by label and seed: its part, its packing, and its foreseen work without the filling."""
    division = WorkPartition([PointDemand(asked, point) for point in asked.points], CAN, [1.0] * of)
    return {
        (run.point.label, run.seed): (division.number(run), run.keys(CAN).packing, discharge_work(run.shared))
        for run in demands(asked, seeds)
    }


def test_runs_from_one_packing_are_in_one_part(tmp_path):
    """Outlets of a flat bottom share packings, inclined bottoms have their own."""
    asked = study(tmp_path, replicates=9, orifices="[18, 21, 24]").change(
        {"sweep.container.angle": ["60 deg", "90 deg"]}
    )
    found = parts(asked, 4, 9)
    by_packing: dict[str, set] = {}
    for part, packing, _ in found.values():
        by_packing.setdefault(packing, set()).add(part)
    assert len(by_packing) < len(found)
    assert all(len(of) == 1 for of in by_packing.values())
    assert {part for part, _, _ in found.values()} == {1, 2, 3, 4}


@pytest.mark.parametrize("of", [2, 5, 16])
def test_parts_are_even_in_work_and_not_in_number(of, tmp_path):
    """Counts of grains from 100 to 1600: a discharge takes up to 256 times as many grain-steps as another."""
    counts = [100 * k for k in range(1, 17)]
    asked = study(tmp_path, orifices="[24, 30]").change({"sweep.grains.count": counts})
    points = [PointDemand(asked, point) for point in asked.points]
    runs = list(demands(asked, 4))
    division = WorkPartition(points, CAN, [1.0] * of)
    work = {run.keys(CAN).packing: fill_work(run) for run in runs}
    loads, number = [0.0] * of, [0] * of
    for run in runs:
        part = division.number(run) or 0
        loads[part - 1] += discharge_work(run.shared) + work.pop(run.keys(CAN).packing, 0.0)
        number[part - 1] += 1
    largest = max(fill_work(run) + 2 * discharge_work(run.shared) for run in runs)
    assert max(loads) - min(loads) <= largest * 1.01, "each packing went to where it ended soonest"
    assert max(loads) <= (1.3 if of == 16 else 1.05) * sum(loads) / of
    if of == 16:  # one packing a seed for each part
        assert max(number) > min(number)


def test_more_replicates_change_no_part_and_faster_ones_have_more(tmp_path):
    few, many = study(tmp_path, replicates=3), study(tmp_path, replicates=12)
    assert parts(many, 5, 12).items() >= parts(few, 5, 3).items()
    division = WorkPartition([PointDemand(many, point) for point in many.points], CAN, [3.0, 1.0])
    runs = list(demands(many, 12))
    assert sum(division.number(run) == 1 for run in runs) == pytest.approx(0.75 * len(runs), abs=2)
    inner = WorkPartition([PointDemand(many, p) for p in many.points], CAN, [1.0, 1.0], division.holds(1))
    assert {inner.number(run) for run in runs if division.number(run) == 1} == {1, 2}
    assert {inner.number(run) for run in runs if division.number(run) == 2} == {None}


def test_a_part_without_runs_says_so(tmp_path):
    ended = labbook("run", study_file(tmp_path), "--lab", tmp_path / "lab", "--backend", "toy", "--shard", "7/9")
    assert "Part 7/9 has no runs: the study has fewer packings than parts" in ended.output


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "a/b", "1/0", "-1/2", "1/999999"])
def test_a_part_that_there_is_not_is_refused(text, tmp_path):
    given = ["run", str(study_file(tmp_path)), "--lab", str(tmp_path / "lab"), f"--shard={text}"]
    result = CliRunner().invoke(build(), given)
    assert result.exit_code == 1
    assert "write I/N" in result.output
    assert not (tmp_path / "lab").exists()


def test_a_run_that_is_done_is_looked_at_alone(tmp_path, monkeypatch):
    looked = []
    item = Planner._item
    monkeypatch.setattr(
        Planner, "_item", lambda self, demand, *more: looked.append(demand.seed) or item(self, demand, *more)
    )
    summary = carry_out(study(tmp_path, replicates=6), tmp_path / "lab", backend=Backend(), workers=1)
    assert summary.complete
    assert len(looked) <= 2 * summary.requested
