"""Two backends on one study: shared packings and own ones, each in its precision, and nothing run twice."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from labbook_toy import Backend, Twin
from toy_lab import carry_out
from toy_pair import compared, records, stamps, stamps_of_packings, study

from labbook.checks.compare.compare import compare, select_points, stale
from labbook.checks.compare.sides import Side
from labbook.checks.compare.verdict import Verdict, path_of
from labbook.lab import Catalogue, LabFolder
from labbook.plan.coverage import finished
from labbook.plan.demand import PackingsOf
from labbook.plan.plan import flow_rates
from labbook.run.runner import Runner
from labbook.stats.nested import by_bed, of_beds

# shared packings


def test_the_second_backend_starts_from_the_first_ones_packings(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    carry_out(asked, lab)
    summary = Runner(asked, LabFolder(lab), Twin(), packings_of=PackingsOf(Backend().capabilities, "double")).run()
    assert len(summary.tally.ran) == 4
    assert summary.tally.packings == 0
    first, second = records(lab, "toy"), records(lab, "twin")
    for at, one in first.items():
        other = second[at]
        assert (other.packing_key, other.experiment_key) == (one.packing_key, one.experiment_key)
        assert other.run_key != one.run_key
        a, b = (np.load(lab / "runs" / key / "crossing.npz")["time"] for key in (one.run_key, other.run_key))
        np.testing.assert_array_equal(a, b)  # the toy's grains leave as the bits of the start say


def test_an_backend_never_fills_in_another_ones_place(tmp_path):
    asked, lab = study(tmp_path, replicates=1), tmp_path / "lab"
    summary = Runner(asked, LabFolder(lab), Twin(), packings_of=PackingsOf(Backend().capabilities, "double")).run()
    assert not summary.tally.ran
    assert not summary.tally.packings
    assert summary.tally.failed
    assert all("toy has to make this packing first" in why for why in summary.tally.failed)


def test_packings_can_be_made_alone(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    first = Runner(asked, LabFolder(lab), Twin(), packings_only=True).run()
    assert (first.tally.packings, first.tally.ran) == (2, {})
    assert not (lab / "runs").exists()
    before = stamps_of_packings(lab)
    assert Runner(asked, LabFolder(lab), Twin(), packings_only=True).run().work_done == 0
    carry_out(asked, lab, backend=Twin())
    assert stamps_of_packings(lab) == before


def test_runs_from_foreign_packings_stay_out_of_a_studys_own(tmp_path):
    asked, lab = study(tmp_path, orifices="[24]"), tmp_path / "lab"
    compared(asked, lab)
    assert len(finished(Catalogue(lab), asked, "toy")) == 2
    assert finished(Catalogue(lab), asked, "twin") == []


class Mixed(Twin):
    """Works in both precisions, which are the same to it."""

    def __init__(self, **given):
        super().__init__(**given)
        self.capabilities = replace(self.capabilities, precisions=frozenset({"double", "mixed"}))

    def specialise(self, scene, numerics, probes=()):
        spec = super().specialise(scene, numerics.model_copy(update={"precision": "double"}), probes)
        return replace(spec, features=(*spec.features, ("precision", numerics.precision)))


def test_each_side_works_in_its_own_precision(tmp_path):
    asked, lab = study(tmp_path, orifices="[24]"), tmp_path / "lab"
    two = Side(Backend(), "cpu", "double"), Side(Mixed(), "cpu", "mixed")
    verdict, failed = compare(asked, LabFolder(lab), two, 0.03)
    assert not failed
    assert [entrant.called for entrant in verdict.entrants] == ["toy-double", "twin-mixed"]
    first, second = records(lab, "toy"), records(lab, "twin")
    assert {one.numerics.precision for one in first.values()} == {"double"}
    assert {one.numerics.precision for one in second.values()} == {"mixed"}
    assert {one.experiment_key for one in first.values()} == {one.experiment_key for one in second.values()}
    assert not carry_out(asked, lab).tally.ran, "the study's own precision is double"
    kept = Verdict.read(path_of(LabFolder(lab), asked.name, "toy-double", "twin-mixed"))
    assert kept == verdict


def test_one_backend_in_two_precisions(tmp_path):
    asked, lab = study(tmp_path, orifices="[24]"), tmp_path / "lab"
    two = Side(Mixed(), "cpu", "double"), Side(Mixed(), "cpu", "mixed")
    verdict, failed = compare(asked, LabFolder(lab), two, 0.03)
    assert not failed
    (point,) = verdict.points
    assert not set(point.runs[0]) & set(point.runs[1])
    assert point.contrasts[0].difference == 0
    assert len(stamps_of_packings(lab)) == 4, "each precision makes its own packings, too"


# nothing is run twice


@pytest.mark.slow
def test_what_is_there_is_not_run_again(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    carry_out(asked, lab)
    own = stamps(lab)
    first = compared(asked, lab)
    before = stamps(lab)
    assert own.items() <= before.items(), "the study's own runs are used"
    assert len(before) == 4 + 4 + 2 + 2, "two backends' runs and packings"
    second = compared(asked, lab)
    assert stamps(lab) == before
    assert second.points == first.points
    assert second.costs == first.costs, "the last session that ran anything still counts"
    assert not carry_out(asked, lab).tally.ran, "what was made for a comparison are the study's runs"


@pytest.mark.slow
def test_more_replicates_add_only_those(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    compared(asked, lab)
    before = stamps(lab)
    verdict = compared(select_points(asked, (1,), 3), lab)
    after = stamps(lab)
    assert before.items() <= after.items()
    assert len(after) - len(before) == 2 + 2, "a run and a packing of each backend"
    assert [(point.index, len(point.runs[0])) for point in verdict.points] == [(1, 3)]


def test_beds_that_are_discharged_several_times_count_by_their_means(tmp_path):
    asked, lab = study(tmp_path, "discharges_per_bed: 2", orifices="[24]"), tmp_path / "lab"
    verdict = compared(asked, lab)
    (point,) = verdict.points
    assert [len(runs) for runs in point.runs] == [4, 4]
    flow = next(one for one in point.contrasts if one.quantity == "flow_rate")
    assert flow.seeds == (1, 2)
    with closing(Catalogue(lab)) as catalogue:
        runs = {run.entry.run_key: (run.seed, run.discharge) for run in finished(catalogue, asked, "toy")}
        rates = flow_rates(asked, catalogue, list(runs))
    beds = by_bed((seed, rates[key]) for key, (seed, _) in runs.items())
    assert [len(each) for each in beds.values()] == [2, 2]
    assert flow.first == pytest.approx(of_beds(beds))
    assert not stale(verdict, asked)
