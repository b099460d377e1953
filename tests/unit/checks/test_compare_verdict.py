"""What a comparison finds, what it refuses, and when its verdict is stale."""

import shutil

import pytest
from labbook_toy import Backend, Ensemble, Twin
from toy_pair import compared, contestants, study

from labbook.backend import Unsupported
from labbook.checks.compare.compare import compare, select_points, stale
from labbook.checks.compare.sides import CannotCompare, Side
from labbook.checks.compare.verdict import NoVerdict, Verdict, path_of
from labbook.cli.work.sides import parse
from labbook.lab import LabFolder
from labbook.measure import MEASURES
from labbook.scene import HertzMindlin

BIAS = 0.07


# what a comparison finds


@pytest.fixture(scope="module")
def equals(tmp_path_factory):
    """Two equal backends that were compared: the study, its lab and the verdict."""
    folder = tmp_path_factory.mktemp("equals")
    asked = study(folder)
    return asked, folder / "lab", compared(asked, folder / "lab")


def test_equal_backends_are_equivalent(equals):
    *_, verdict = equals
    assert verdict.finding == "equivalent"
    for point in verdict.points:
        flow, packing = point.contrasts
        assert (flow.paired, packing.paired) == (True, False)
        assert flow.first == flow.second
        assert flow.difference == packing.difference == 0


@pytest.mark.slow
def test_a_bias_is_found_as_large_as_it_is(tmp_path):
    asked, lab = study(tmp_path, replicates=4, orifices="[24]"), tmp_path / "lab"
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
    assert [point.contrasts[0].finding for point in wide.points] == ["equivalent"]


@pytest.mark.slow
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


class Unfilled(Twin):
    """Can start no filling."""

    def open(self, spec, slots=None, device="cpu"):
        return Refusing(self, spec, slots)


class Refusing(Ensemble):
    def admit(self, scene, numerics, start, *, settled_below=None, **further):
        if settled_below is not None:
            raise ValueError("no room")
        return super().admit(scene, numerics, start, settled_below=settled_below, **further)


def test_packings_that_cannot_be_made_have_no_number(tmp_path):
    asked = study(tmp_path, orifices="[24]")
    ends = [f"packing, seed {seed}: no room" for seed in (1, 2)]
    first, second = contestants(second=Unfilled())
    verdict, failed = compare(asked, LabFolder(tmp_path / "lab"), (first, second), 0.03)
    assert sorted(failed) == ends, "in whichever order lanes came to them"
    flow, packing = verdict.points[0].contrasts
    assert flow.finding == "equivalent", "those of the first backend are there"
    assert (packing.finding, packing.note) == ("untested", "2 without a number: its packing was not made")
    assert len(packing.first) == 2
    verdict, failed = compare(asked, LabFolder(tmp_path / "other"), (second, first), 0.03)
    assert sorted(failed[:2]) == ends
    flow, packing = verdict.points[0].contrasts
    assert (flow.finding, flow.note) == ("untested", "4 without a number: its packing failed: no room")
    assert packing.note == "2 without a number: its packing was not made"
    assert verdict.points[0].divergence is None
    assert [(cost.runs, cost.rate) for cost in verdict.costs] == [(0, None), (0, None)]


# what is refused


def test_what_cannot_be_compared_is_refused(tmp_path):
    asked = study(tmp_path, replicates=1)
    with pytest.raises(CannotCompare, match="--replicates"):
        select_points(asked)
    with pytest.raises(CannotCompare, match="--point 3"):
        select_points(asked, (2,), 2)
    for backends, devices in (("toy", "cpu,cpu"), ("toy,toy", "cpu,cpu"), ("toy,twin", "cpu")):
        with pytest.raises(CannotCompare):
            parse(backends, devices)


def test_a_device_that_is_not_there_is_said_before_anything_runs(tmp_path):
    two = (Side(Backend(), "cpu"), Side(Twin(), "cuda:0"))
    with pytest.raises(Unsupported, match="the toy backend has no cuda:0"):
        compare(study(tmp_path), LabFolder(tmp_path / "lab"), two, 0.03)
    assert not (tmp_path / "lab").exists()


# the stored verdict


def test_a_verdict_is_stale_when_what_it_rests_on_has_changed(equals, tmp_path, monkeypatch):
    asked, _, verdict = equals
    assert stale(verdict, asked) == []
    with monkeypatch.context() as later:
        later.setattr(HertzMindlin, "version", 3)
        later.setattr(HertzMindlin, "changes", {3: "springs rest"})
        assert stale(verdict, asked) == ["law hertz-mindlin version 2, now 3: springs rest"]
    monkeypatch.setenv("LABBOOK_TWIN_VERSION", "2")
    assert stale(verdict, asked) == ["twin was at version 1 and is now at 2"]
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


def test_a_verdict_is_read_as_it_was_written(equals, tmp_path):
    asked, there, verdict = equals
    lab = shutil.copytree(there, tmp_path / "lab")
    path = path_of(LabFolder(lab), asked.name, "toy", "twin")
    assert Verdict.read(path) == verdict
    path.write_text("{}")
    with pytest.raises(NoVerdict, match="cannot be read"):
        Verdict.read(path)
    again = compared(asked, lab)
    assert Verdict.read(path) == again
    assert [point.contrasts for point in again.points] == [point.contrasts for point in verdict.points]
