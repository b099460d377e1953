"""What `labbook run` and `lab.run` say before they start and at their end, and fillings that failed before."""

import warnings

import pytest
from toy_lab import labbook as verb
from toy_lab import study, study_file
from toy_records import records

import labbook
from labbook.lab.journal import FAILURE, unfinished
from labbook.study.problems import grouped

BACKEND = ("--backend", "toy")
ALONE = "with one run per point no number has an error from replicates"


def spoken(lab: labbook.Lab, asked: labbook.Study) -> list[warnings.WarningMessage]:
    """The warnings of a run, each at every place."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        lab.run(asked, progress=False)
    return caught


def test_run_repeats_the_warnings_of_the_plan_before_it_starts(tmp_path):
    path, lab = study_file(tmp_path, orifices="[24]", replicates=1), tmp_path / "lab"
    planned = verb("plan", path, "--lab", lab, *BACKEND).stdout
    assert ALONE in planned
    ended = verb("run", path, "--lab", lab, *BACKEND)
    assert f"Warning: {path}: replicates: {ALONE}" in ended.stderr
    assert ALONE not in ended.stdout
    assert not verb("run", path, "--lab", lab, *BACKEND).stderr, "nothing is left to run"


@pytest.mark.parametrize("progress", [True, False])
def test_python_repeats_them_too_unless_it_is_to_be_quiet(tmp_path, capfd, progress):
    asked, lab = study(tmp_path, orifices="[24]", replicates=1), labbook.Lab(tmp_path / "lab", "toy")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lab.run(asked, progress=progress)
    assert (ALONE in " ".join(capfd.readouterr().err.split())) == progress


def test_a_line_from_within_a_run_stands_there_too(tmp_path, monkeypatch):
    asked, lab = study(tmp_path, orifices="[24]"), labbook.Lab(tmp_path / "lab", "toy")
    monkeypatch.setattr("labbook.run.fill.FillJob.warning", lambda self: "does not seem to come to rest")
    caught = spoken(lab, asked)
    assert {(one.filename, one.category) for one in caught} == {(__file__, labbook.LabWarning)}


def test_reasons_that_differ_in_numbers_only_are_one(tmp_path):
    same = [f"packing, seed {k}: 2500 grains find no room in {k}.5e-3 m ({'0a' * 16})" for k in range(1, 16)]
    (line,) = grouped(same)
    assert line == f"{same[0]} (and 14 more like it)"
    assert grouped([same[0], "another"]) == [same[0], "another"]


TOO_MANY = "fill: {max_time: 1 ms}"
"""No filling comes to rest within that."""


def test_a_filling_that_failed_is_named_by_the_next_plan_with_what_to_change(tmp_path):
    path, lab = study_file(tmp_path, TOO_MANY, orifices="[24]", replicates=3), tmp_path / "lab"
    ended = verb("run", path, "--lab", lab, *BACKEND, check=False)
    assert ended.exit_code == 1
    (line,) = (one for one in ended.stdout.splitlines() if one.startswith("Failed: "))
    assert line.endswith("(and 2 more like it)"), "one line with a count"
    planned = " ".join(verb("plan", path, "--lab", lab, *BACKEND).stdout.split())
    assert "A filling failed before and will be tried again: seed 1: not at rest after 0.0" in planned
    assert "Raise fill.max_time" in planned
    assert "its packing failed: not at rest after" in planned
    assert all("not at rest" in work.failed for work in unfinished(labbook.Lab(lab).lab_folder))
    longer = study(tmp_path, orifices="[24]", replicates=3)
    assert "failed" not in repr(labbook.Lab(lab, "toy").plan(longer)), "it may go on for longer now"
    assert labbook.Lab(lab, "toy").run(longer, progress=False).complete
    assert not list(lab.rglob(FAILURE))


def test_grains_that_find_no_place_are_named_by_the_next_plan(tmp_path, monkeypatch):
    from labbook.filling import PlacingError

    def refuse(*_):
        raise PlacingError("200 grains find no place; make the container higher")

    asked, lab = study(tmp_path, orifices="[24]"), labbook.Lab(tmp_path / "lab", "toy")
    monkeypatch.setattr("labbook.run.fill.place", refuse)
    caught = spoken(lab, asked)
    assert len(caught) == 1, "one warning with a count"
    assert "find no place; make the container higher (and 1 more like it)" in str(caught[0].message)
    assert "find no place; make the container higher" in str(lab.plan(asked))


@pytest.mark.parametrize("measured", ["[flow_rate]", "[packing]"])
def test_a_study_without_any_flow_rate_does_not_end_well(tmp_path, monkeypatch, measured):
    """Every run ends after 20 ms, long before its window does."""
    path = study_file(tmp_path, "stop: {max_time: 20 ms}")
    path.write_text(path.read_text().replace("measure: [flow_rate]", f"measure: {measured}"))
    lab = tmp_path / "lab"
    for _ in range(2):
        ended = verb("run", path, "--lab", lab, *BACKEND, check=False)
        assert len(records(lab)) == 4
        assert "4 of 4 runs done" in ended.stdout
        if measured == "[packing]":
            assert ended.exit_code == 0
            continue
        assert ended.exit_code == 1
        assert "No point of the study has a flow rate: fewer than " in ended.stdout
    part = verb("run", path, "--lab", lab, *BACKEND, "--shard", "1/2", check=False)
    assert part.exit_code == 0, "a part cannot tell"
    if measured == "[flow_rate]":
        said = [str(one.message) for one in spoken(labbook.Lab(lab, "toy"), labbook.load(path))]
        assert any("no point of the study has a flow rate: fewer than" in one for one in said)
