"""Several discharges of each bed: their keys, their folders, and what a killed run leaves of one."""

import json

import numpy as np
import pytest
from toy_lab import arrays, carry_out, content, labbook, study, study_file, unsealed

from labbook.lab import LabFolder, RunRecord, Unreadable
from labbook.lab.catalogue import Catalogue
from labbook.lab.runs import open_run
from labbook.plan.coverage import finished
from labbook.run.discharge import DischargeJob
from labbook.run.stopping import StopRequest

THREE = "discharges_per_bed: 3"


def runs_of(asked, lab) -> dict[tuple[int, int, int], str]:
    """Keys of all runs by point, seed and discharge."""
    with_index = Catalogue(lab)
    try:
        found = finished(with_index, asked, "toy")
        return {(run.point.index, run.seed, run.discharge): run.entry.run_key for run in found}
    finally:
        with_index.close()


def test_beds_are_filled_once_and_their_first_discharge_is_that_of_a_study_without(tmp_path):
    plain, several = study(tmp_path), study(tmp_path, THREE)
    alone, lab = tmp_path / "alone", tmp_path / "lab"
    carry_out(plain, alone)
    done = carry_out(several, lab)
    assert (done.done, done.requested, done.tally.packings) == (12, 12, len([*(alone / "packings").iterdir()]))
    keys = runs_of(several, lab)
    assert sorted(keys) == [(p, s, k) for p in (0, 1) for s in (1, 2) for k in (1, 2, 3)]
    had, now = content(alone), content(lab)
    assert had == {key: now[key] for key in had}
    first = {key for number, key in keys.items() if number[2] == 1}
    assert first == {*runs_of(plain, alone).values()}
    times = [arrays(lab / "runs" / keys[0, 1, k])["crossing.npz/time"] for k in (1, 2, 3)]
    assert len(set(times)) == 3, "each goes another way"


def test_records_tell_the_kick_and_old_ones_none(tmp_path):
    asked = study(tmp_path, THREE, orifices="[18]", replicates=1)
    carry_out(asked, tmp_path / "lab")
    folders = {number: tmp_path / "lab" / "runs" / key for number, key in runs_of(asked, tmp_path / "lab").items()}
    stored = {k: json.loads((folders[0, 1, k] / "run.json").read_text()).get("kick") for k in (1, 2, 3)}
    assert stored == {1: None, 2: {"discharge": 2, "version": 1}, 3: {"discharge": 3, "version": 1}}
    said = [RunRecord.read(folders[0, 1, k]).repeat for k in (1, 2)]
    assert said == ["seed 1", "seed 1, discharge 2"]


def test_a_run_that_was_stopped_goes_on_with_the_same_bits(tmp_path, monkeypatch):
    asked = study(tmp_path, "discharges_per_bed: 2", orifices="[18]", replicates=1)
    carry_out(asked, tmp_path / "whole")
    request, verdict = StopRequest(), DischargeJob.verdict

    def stopped_half_way(self, events):
        if self.demand.discharge == 2 and self.progress() > 0.4:
            request.requested = True
        return verdict(self, events)

    monkeypatch.setattr(DischargeJob, "verdict", stopped_half_way)
    carry_out(asked, tmp_path / "lab", request=request, workers=1)
    monkeypatch.undo()
    again = carry_out(asked, tmp_path / "lab")
    assert again.tally.resumed == 1
    assert again.done == again.requested == 2
    assert content(tmp_path / "lab") == content(tmp_path / "whole")


def test_only_first_discharges_are_recorded(tmp_path):
    asked = study(tmp_path, THREE, "record: {replicates: 2}", orifices="[18]")
    carry_out(asked, tmp_path / "lab")
    lab = LabFolder(tmp_path / "lab")
    recorded = [n for n, key in runs_of(asked, lab).items() if (lab.run(key) / "recording.npz").exists()]
    assert recorded == [(0, 1, 1), (0, 2, 1)]


def test_listings_number_the_discharges(tmp_path):
    path, lab = study_file(tmp_path, "discharges_per_bed: 2", orifices="[18]", replicates=1), tmp_path / "lab"
    labbook("run", path, "--lab", lab, "--backend", "toy")
    listed = json.loads(labbook("runs", "--lab", lab, "--json").stdout)
    assert sorted((row["seed"], row["discharge"]) for row in listed) == [(1, 1), (1, 2)]
    assert "discharge" in labbook("runs", "--lab", lab).stdout
    second = next(row["run_key"] for row in listed if row["discharge"] == 2)
    assert "seed 1, discharge 2" in labbook("show", second, "--lab", lab).stdout


def test_means_are_of_beds(tmp_path):
    """The pooled mean and its error are those of the means of beds, with as many degrees of freedom."""
    from labbook import Lab

    asked = study(tmp_path, THREE, orifices="[18]", replicates=3)
    carry_out(asked, tmp_path / "lab")
    (point,) = Lab(tmp_path / "lab", "toy").results(asked).points
    rates = np.array([run.measured["flow_rate"].value for run in point.runs]).reshape(3, 3)
    assert [(run.seed, run.discharge) for run in point.runs] == [(s, k) for s in (1, 2, 3) for k in (1, 2, 3)]
    pooled = point.pooled["flow_rate"]
    assert pooled.n == 3
    assert pooled.value == pytest.approx(rates.mean())
    assert pooled.error == pytest.approx(rates.mean(axis=1).std(ddof=1) / np.sqrt(3))


def test_the_cheapest_number_is_looked_for_and_found_again(tmp_path, monkeypatch):
    """What is proposed follows from the results: a study that was run before asks for nothing more."""
    import labbook.plan.plan as module
    from labbook import Lab

    monkeypatch.setattr(module, "filling_cost", lambda *_: 20.0)
    more = "accuracy: {flow_rate: 2 %, max_replicates: 30}", "discharges_per_bed: auto"
    asked = study(tmp_path, *more, orifices="[18]", replicates=3)
    done = carry_out(asked, tmp_path / "lab")
    numbers = sorted(number[1:] for number in runs_of(asked, tmp_path / "lab"))
    beds, discharges = numbers[-1]
    assert discharges > 1, "fillings are dear"
    assert numbers == [(s, k) for s in range(1, beds + 1) for k in range(1, discharges + 1)], "all have as many"
    assert done.tally.packings == beds
    again = carry_out(asked, tmp_path / "lab")
    assert (again.done, again.requested, again.tally.ran) == (len(numbers), len(numbers), {})
    (said,) = (line for line in again.lines() if "flow rate to" in line)
    assert f"{beds} replicates of {discharges} discharges" in said
    assert "of the variance of W is made in the flow" in said
    plan = Lab(tmp_path / "lab", "toy").plan(asked)
    assert not plan.todo
    ((line, labels),) = plan.shares.items()
    assert (labels, "as in other scenes" in line) == (("orifice 18 mm",), False)
    assert f"Discharges: {line}" in plan.lines()


def test_the_cost_of_a_filling_is_that_of_its_steps(tmp_path):
    from labbook.lab.packings import PackingRecord
    from labbook.plan.beds import filling_cost

    asked = study(tmp_path, orifices="[18]", replicates=1)
    carry_out(asked, tmp_path / "lab")
    lab, (key,) = LabFolder(tmp_path / "lab"), runs_of(asked, tmp_path / "lab").values()
    run = RunRecord.read(lab.run(key))
    packing = PackingRecord.read(lab.packing(run.packing_key))
    steps = packing.sessions[-1].to_step / run.coverage.steps
    inside = 1 - run.coverage.crossed / run.coverage.grains / 2
    cost = filling_cost(lab, [(key, run.packing_key)])
    assert cost == pytest.approx(steps / inside)
    assert filling_cost(lab, [(key, run.packing_key)], points=4) == pytest.approx(cost / 4)


def test_runs_with_kicks_are_imported_and_indexed_again(tmp_path):
    path, lab, other = study_file(tmp_path, THREE, orifices="[18]"), tmp_path / "lab", tmp_path / "other"
    labbook("run", path, "--lab", lab, "--backend", "toy")
    labbook("import", lab, "--lab", other)
    labbook("reindex", "--lab", other)
    assert content(other) == content(lab)
    listed = json.loads(labbook("runs", "--lab", other, "--json").stdout)
    assert sorted((row["seed"], row["discharge"]) for row in listed) == [(s, k) for s in (1, 2) for k in (1, 2, 3)]


def test_a_record_with_the_kick_of_another_discharge_is_damaged(tmp_path):
    asked = study(tmp_path, "discharges_per_bed: 2", orifices="[18]", replicates=1)
    carry_out(asked, tmp_path / "lab")
    folder = tmp_path / "lab" / "runs" / runs_of(asked, tmp_path / "lab")[0, 1, 2]
    record = folder / "run.json"
    record.write_text(unsealed(record.read_text()).replace('"discharge": 2', '"discharge": 3'))
    with pytest.raises(Unreadable, match="experiment_key: it does not match the record"):
        open_run(folder)
    labbook("reindex", "--lab", tmp_path / "lab", check=False)
    again = carry_out(asked, tmp_path / "lab")
    assert len(again.tally.ran) == 1, "the damaged run is made again, and no other"
