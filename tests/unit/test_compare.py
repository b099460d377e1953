"""Comparing two engines, on the toy and its twin: same runs, shared packings, verdicts and when they are stale."""

import json
import signal
import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from labbook_toy import Backend, Ensemble, Twin
from toy_lab import carry_out, labbook, start
from toy_lab import study as toy_study
from toy_lab import study_file as toy_study_file

from labbook.backend import Unsupported
from labbook.catalogue import Catalogue, Lab, RunRecord
from labbook.compare.compare import CannotCompare, compare, demands, narrowed
from labbook.compare.divergence import AGREE, divergence
from labbook.compare.lockstep import side_by_side
from labbook.compare.pair import Contestant, WrongPair, pair
from labbook.compare.stale import stale
from labbook.compare.verdict import NoVerdict, Verdict, folder_of
from labbook.measure import MEASURES
from labbook.plan.demand import PackingsOf
from labbook.probes import Sample
from labbook.protocol.placing import place
from labbook.runner.runner import Runner

BIAS = 0.07
GRAINS = 400  # enough for a bulk to measure the packing fraction in


def study(folder, *more, **changes):
    return toy_study(folder, *more, count=GRAINS, **changes)


def study_file(folder):
    return toy_study_file(folder, count=GRAINS)


def contestants(first=None, second=None):
    return Contestant(first or Backend(), "cpu"), Contestant(second or Twin(), "cpu")


def compared(asked, lab, second=None, margin=0.03):
    verdict, failed = compare(asked, Lab(lab), contestants(second=second), margin)
    assert not failed
    return verdict


def stamps(lab):
    return {path.name: path.stat().st_mtime_ns for kind in ("runs", "packings") for path in (lab / kind).iterdir()}


def records(lab, engine):
    found = map(RunRecord.read, (lab / "runs").iterdir())
    return {(one.label, one.seed): one for one in found if one.engine == engine}


# shared packings


def test_the_second_engine_starts_from_the_first_ones_packings(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    carry_out(asked, lab)
    summary = Runner(asked, Lab(lab), Twin(), packings_of=PackingsOf(Backend().capabilities, "double")).run()
    assert len(summary.tally.ran) == 4
    assert summary.tally.packings == 0
    first, second = records(lab, "toy"), records(lab, "twin")
    for at, one in first.items():
        other = second[at]
        assert (other.packing_key, other.experiment_key) == (one.packing_key, one.experiment_key)
        assert other.run_key != one.run_key
        a, b = (np.load(lab / "runs" / key / "crossing.npz")["time"] for key in (one.run_key, other.run_key))
        np.testing.assert_array_equal(a, b)  # the toy's grains leave as the bits of the start say


def test_an_engine_never_fills_in_another_ones_place(tmp_path):
    asked, lab = study(tmp_path, replicates=1), tmp_path / "lab"
    summary = Runner(asked, Lab(lab), Twin(), packings_of=PackingsOf(Backend().capabilities, "double")).run()
    assert not summary.tally.ran
    assert not summary.tally.packings
    assert summary.tally.failed
    assert all("toy has to make this packing first" in why for why in summary.tally.failed)


def test_packings_can_be_made_alone(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    first = Runner(asked, Lab(lab), Twin(), packings_only=True).run()
    assert (first.tally.packings, first.tally.ran) == (2, {})
    assert not (lab / "runs").exists()
    before = stamps_of_packings(lab)
    assert Runner(asked, Lab(lab), Twin(), packings_only=True).run().work_done == 0
    carry_out(asked, lab, engine=Twin())
    assert stamps_of_packings(lab) == before


def stamps_of_packings(lab):
    return {path.name: path.stat().st_mtime_ns for path in (lab / "packings").iterdir()}


def test_runs_from_foreign_packings_stay_out_of_a_studys_own(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    compared(asked, lab)
    assert len(Catalogue(lab).finished(asked, "toy")) == 4
    assert Catalogue(lab).finished(asked, "twin") == []


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
    two = Contestant(Backend(), "cpu", "double"), Contestant(Mixed(), "cpu", "mixed")
    verdict, failed = compare(asked, Lab(lab), two, 0.03)
    assert not failed
    assert [entrant.called for entrant in verdict.entrants] == ["toy-double", "twin-mixed"]
    first, second = records(lab, "toy"), records(lab, "twin")
    assert {one.numerics.precision for one in first.values()} == {"double"}
    assert {one.numerics.precision for one in second.values()} == {"mixed"}
    assert {one.experiment_key for one in first.values()} == {one.experiment_key for one in second.values()}
    assert not carry_out(asked, lab).tally.ran, "the study's own precision is double"
    kept = Verdict.read(folder_of(Lab(lab), asked.name) / "toy-double-twin-mixed.json")
    assert kept == verdict


def test_one_engine_in_two_precisions(tmp_path):
    asked, lab = study(tmp_path, orifices="[24]"), tmp_path / "lab"
    two = Contestant(Mixed(), "cpu", "double"), Contestant(Mixed(), "cpu", "mixed")
    verdict, failed = compare(asked, Lab(lab), two, 0.03)
    assert not failed
    (point,) = verdict.points
    assert not set(point.runs[0]) & set(point.runs[1])
    assert point.contrasts[0].difference == 0
    assert len(stamps_of_packings(lab)) == 4, "each precision makes its own packings, too"


# nothing is run twice


def test_what_is_there_is_not_run_again(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    carry_out(asked, lab)
    own = stamps(lab)
    first = compared(asked, lab)
    before = stamps(lab)
    assert own.items() <= before.items(), "the study's own runs are used"
    assert len(before) == 4 + 4 + 2 + 2, "two engines' runs and packings"
    second = compared(asked, lab)
    assert stamps(lab) == before
    assert second.points == first.points
    assert second.costs == first.costs, "the last session that ran anything still counts"
    assert not carry_out(asked, lab).tally.ran, "what was made for a comparison are the study's runs"


def test_more_replicates_add_only_those(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    compared(asked, lab)
    before = stamps(lab)
    verdict = compared(narrowed(asked, (1,), 3), lab)
    after = stamps(lab)
    assert before.items() <= after.items()
    assert len(after) - len(before) == 2 + 2, "a run and a packing of each engine"
    assert [(point.index, len(point.runs[0])) for point in verdict.points] == [(1, 3)]


# what a comparison finds


def test_equal_engines_are_equivalent(tmp_path):
    verdict = compared(study(tmp_path), tmp_path / "lab")
    assert verdict.finding == "equivalent"
    for point in verdict.points:
        flow, packing = point.contrasts
        assert (flow.paired, packing.paired) == (True, False)
        assert flow.first == flow.second
        assert flow.difference == packing.difference == 0


def test_a_bias_is_found_as_large_as_it_is(tmp_path):
    asked, lab = study(tmp_path, replicates=4), tmp_path / "lab"
    verdict = compared(asked, lab, Twin(bias=BIAS))
    assert verdict.finding == "different"
    for point in verdict.points:
        flow, packing = point.contrasts
        assert flow.difference == pytest.approx(BIAS, rel=1e-9)
        assert flow.finding == "different"
        assert flow.low is not None
        assert 0.03 < flow.low < BIAS
        assert packing.difference == 0, "it does not hang on the outlet"
    wide = compared(asked, lab, Twin(bias=BIAS), margin=0.1)
    assert [point.contrasts[0].finding for point in wide.points] == ["equivalent"] * 2


def test_too_few_numbers_leave_a_point_untested(tmp_path):
    """An outlet of less than three diameters clogs: its runs have no flow rate."""
    verdict = compared(study(tmp_path, "stop: {stall: 0.5 s}", orifices="[8, 24]"), tmp_path / "lab")
    clogged, flowing = (point.contrasts[0] for point in verdict.points)
    assert (clogged.finding, flowing.finding) == ("untested", "equivalent")
    assert "4 without a number" in clogged.note
    assert "clogged" in clogged.note
    assert verdict.finding == "undecided"


def test_runs_that_a_guard_stopped_have_no_number(tmp_path):
    asked = study(tmp_path, replicates=3, orifices="[24]")
    flow, packing = compared(asked, tmp_path / "lab", Twin(fails=24)).points[0].contrasts
    assert (flow.finding, flow.note) == ("untested", "3 without a number: diverged")
    assert packing.seeds == (1, 2, 3)


# drifting apart


class Drifting(Twin):
    """Every grain is off by d 10^-9 exp(t/tau), a hundred times less but for the one with id 0."""

    TAU = 0.01

    def open(self, spec, slots=None, device="cpu"):
        return DriftingEnsemble(self, spec, slots)


class DriftingEnsemble(Ensemble):
    def drain(self):
        tables = {}
        for probe, table in super().drain().items():
            size = 3e-3 * 1e-9 * np.exp(table["time"] / Drifting.TAU) if isinstance(probe, Sample) else 0.0
            tables[probe] = {**table, "x": table["x"] + size * np.where(table["id"] == 0, 1.0, 0.01)}
        return tables


def test_engines_agree_until_the_largest_difference_exceeds_a_thousandth(tmp_path):
    # an outlet that clogs at once: the grain 0 stays
    asked, lab = study(tmp_path, "stop: {stall: 0.5 s}", orifices="[5]"), tmp_path / "lab"
    carry_out(asked, lab)
    two = contestants(second=Drifting())
    first, second = (demands(asked, asked.points[0], two, one, 1)[0] for one in two)
    found = divergence(two, (first, second), Lab(lab), {})
    expected = Drifting.TAU * np.log(AGREE / 1e-9)
    frame = found.time[1]
    assert expected - frame < found.agree_until <= expected
    assert found.ended == "diverged"
    assert found.time[-1] == pytest.approx(Drifting.TAU * np.log(1e9), abs=frame)
    ratio = np.array(found.largest[1:]) / np.array(found.median[1:])
    np.testing.assert_allclose(ratio[-10:], 100, rtol=1e-6)
    growth = np.log(found.largest[-1] / found.largest[-11]) / (found.time[-1] - found.time[-11])
    assert growth == pytest.approx(1 / Drifting.TAU, rel=1e-6)


def test_engines_that_never_part_agree_to_the_end(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    found = compared(asked, lab).points[0].divergence
    assert found is not None
    assert set(found.largest) == {0.0}
    assert found.agree_until == found.time[-1]
    assert found.ended in ("longest", "empty")


def test_frames_are_of_the_same_moments(tmp_path):
    asked = study(tmp_path)
    point = asked.points[1]
    numerics = point.numerics.model_copy(update={"steps_per_beat": 50})
    start = place(point.scene.close(), "rain", 1)
    with side_by_side(contestants(), point.scene, numerics, start, Sample(fields=("x",), every=2)) as both:
        frames = list(both.frames(0.0105))
        assert both.walkers[0].rate
    assert [frame.time for frame in frames] == pytest.approx(np.arange(1, 11) * 1e-3)
    for frame in frames:
        for table in frame.tables:
            assert set(np.round(table["time"], 12)) == {round(frame.time, 12)}
            assert all(a < b for a, b in pairwise(table["id"]))


# what is refused


def test_what_cannot_be_compared_is_refused(tmp_path):
    asked = study(tmp_path, replicates=1)
    with pytest.raises(CannotCompare, match="--replicates"):
        narrowed(asked)
    with pytest.raises(CannotCompare, match="--point 3"):
        narrowed(asked, (2,), 2)
    for backends, devices in (("toy", "cpu,cpu"), ("toy,toy", "cpu,cpu"), ("toy,twin", "cpu")):
        with pytest.raises(WrongPair):
            pair(backends, devices)


def test_a_device_that_is_not_there_is_said_before_anything_runs(tmp_path):
    two = (Contestant(Backend(), "cpu"), Contestant(Twin(), "cuda:0"))
    with pytest.raises(Unsupported, match="cpu only"):
        compare(study(tmp_path), Lab(tmp_path / "lab"), two, 0.03)
    assert not (tmp_path / "lab").exists()


# the stored verdict


def test_a_verdict_is_stale_when_what_it_rests_on_has_changed(tmp_path, monkeypatch):
    asked, lab = study(tmp_path), tmp_path / "lab"
    verdict = compared(asked, lab)
    assert stale(verdict, asked) == []
    monkeypatch.setenv("LABBOOK_TWIN_VERSION", "2")
    assert stale(verdict, asked) == ["twin was at version 1 and is at 2"]
    monkeypatch.delenv("LABBOOK_TWIN_VERSION")
    other = study(tmp_path, orifices="[18, 27]")
    assert stale(verdict, other) == ["the study has changed at orifice 24 mm"]
    flow = MEASURES["flow_rate"]
    monkeypatch.setattr(type(flow), "version", flow.version + 1)
    assert any("the measure flow_rate" in reason for reason in stale(verdict, asked))
    gone = verdict.model_copy(
        update={"entrants": (verdict.entrants[0], verdict.entrants[1].model_copy(update={"name": "nobody"}))}
    )
    assert any("nobody" in reason for reason in stale(gone, asked))


def test_a_verdict_is_read_as_it_was_written(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    verdict = compared(asked, lab)
    path = folder_of(Lab(lab), asked.name) / "toy-twin.json"
    assert Verdict.read(path) == verdict
    path.write_text("{}")
    with pytest.raises(NoVerdict, match="cannot be read"):
        Verdict.read(path)
    again = compared(asked, lab)
    assert Verdict.read(path) == again
    assert [point.contrasts for point in again.points] == [point.contrasts for point in verdict.points]


@pytest.mark.slow
def test_the_verb_from_nothing_to_a_stale_verdict(tmp_path):
    path, lab = study_file(tmp_path), tmp_path / "lab"
    words = ("compare", path, "--lab", lab, "--backends", "toy,twin")
    missing = labbook(*words, "--show", check=False)
    assert missing.returncode == 1
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
    assert later["stale"] == ["twin was at version 1 and is at 2"]
    assert "STALE: twin was at version 1" in labbook(*words, "--show", LABBOOK_TWIN_VERSION="2").stdout
    biased = labbook(*words, "--replicates", 4, LABBOOK_TWIN_VERSION="3", LABBOOK_TOY_BIAS=str(BIAS), check=False)
    assert biased.returncode == 1
    assert "DIFFERENT by more than 3 %" in biased.stdout


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--devices", "cpu,cuda:0"), "cpu only"),
        (("--backends", "toy,nobody"), "no engine is called nobody"),
        (("--point", "9"), "has the points 1 to 2"),
        (("--precisions", "double,half"), "there is no half"),
        (("--show", "--backends", "toy"), "two words with a comma"),
    ],
)
def test_mistakes_are_told_in_a_line(tmp_path, more, said):
    ended = labbook(
        "compare", study_file(tmp_path), "--lab", tmp_path / "lab", "--backends", "toy,twin", *more, check=False
    )
    assert ended.returncode == 1
    assert said in ended.stderr
    assert "Traceback" not in ended.stderr


def test_what_was_stopped_goes_on(tmp_path):
    path, lab = study_file(tmp_path), tmp_path / "lab"
    words = ("compare", path, "--lab", lab, "--backends", "toy,twin")
    process = start(*words, delay=0.02)
    deadline = time.monotonic() + 60
    while not list((lab / "work").glob("*.lock")):
        assert process.poll() is None
        assert time.monotonic() < deadline
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Stopped early" in said
    assert not (lab / "compare").exists()
    assert "in all 4 tests" in labbook(*words).stdout
