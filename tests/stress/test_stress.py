"""Every case of `labbook stress` on the compiled backends, and that the suite notices what it looks for."""

import json
from pathlib import Path

import broken_backends as broken
import pytest
from platforms import platforms, where
from typer.testing import CliRunner

from labbook.backend import Unsupported
from labbook.checks.stress.bounded import NamedBackend, judge_isolated
from labbook.checks.stress.case import Ending, judge, within
from labbook.checks.stress.cases import CASES, select_cases
from labbook.checks.verify.case import limited
from labbook.checks.verify.platform import Platform, require
from labbook.cli import build

IN_ONE = {
    *("pyramid", "edges", "wall-sums", "time-step", "stiffness", "incline", "units", "size-ratio"),
    *("rods-stacked", "powers", "meshes", "moving-parts"),
}
"""Cases that take long, or kernels of their own: a backend takes them in its first precision only."""
OF_ITS_OWN = {"pyramid", "size-ratio", "powers", "meshes", "moving-parts"}
"""Cases whose kernels, which no other case shares, take ten seconds and more to compile: in the ring. The contract and
`labbook verify` have rolling springs, mixtures and powers too."""


def checks():
    """Every case on every platform of a compiled backend that takes it."""
    for platform in platforms():
        if platform.part < 1:  # plain Python would take hours
            continue
        here = where(platform)
        for case in CASES:
            name = platform.backend.capabilities.name if platform.device == "cpu" else ""
            # a hundred thousand launches; the moving cases of `labbook verify` are there
            lasts = name == "warp" and case.name == "moving-parts"
            if not lasts and not (platform.second and case.name in IN_ONE):
                long = case.slow or case.name in OF_ITS_OWN
                # kernels of a second precision compile for a minute; the GPU backend's processor takes a step a launch
                long |= platform.device == "cpu" and (platform.second or name == "warp")
                marks = [*here.marks, pytest.mark.ring if long else pytest.mark.slow]
                yield pytest.param(case, platform, id=f"{case.name}-{here.id}", marks=marks)


@pytest.mark.parametrize(("case", "platform"), list(checks()))
def test_case(case, platform):
    rows = judge(case, platform)
    assert not [f"{row.part}: {row.figure}" for row in rows if row.outcome == "failed"]
    assert any(row.outcome in ("right", "named error") for row in rows)


def test_names_are_unique_and_chosen_by_their_beginning():
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    assert set(names) > IN_ONE
    assert [case.name for case in select_cases(["pyr"])] == ["pyramid", "pyramid-long"]
    assert select_cases([]) == list(CASES)
    with pytest.raises(KeyError):
        select_cases(["no-such-case"])


# that it can fail


def told(run, made=None) -> Ending:
    """The one row of a case on the toy backend, whose ensembles are `made`."""
    backend = broken.Faulty(made or broken.Ensemble)
    (row,) = judge(broken.case(run), Platform(backend))  # pyright: ignore[reportArgumentType]
    return Ending(row.part, row.outcome, row.figure)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (broken.Silent, "no guard has named this: packing: v is not finite in row 0"),
        (broken.Stationary, "a beat of 100 steps took 0, and no event says why"),
        (broken.Spoiling, "after the error x is not that of the last good beat"),
        (broken.Moving, "stands at step 40, not at 0"),
        (broken.Mumbling, "names no grain or no remedy"),
        (broken.Inventive, "no guard is called 'mood'"),
        (broken.Raising, "IndexError: beyond the end"),
    ],
)
def test_a_backend_that_breaks_is_reported(made, words):
    ending = told(broken.stops, made)
    assert ending.outcome == "failed"
    assert words in ending.figure


def test_a_guard_that_keeps_the_last_good_state_is_a_named_error():
    ending = told(broken.stops, broken.Guarded)
    assert (ending.outcome, ending.figure) == ("named error", broken.Guarded.message)


def test_lists_that_are_too_short_are_named_but_no_guard():
    ending = told(broken.stops, broken.Cramped)
    assert ending.outcome == "failed"
    assert "99 near neighbours" in ending.figure


def test_a_guard_where_the_motion_should_be_right_and_silence_where_it_should_not_have_failed():
    assert told(broken.runs, broken.Guarded).figure.startswith("stopped, but the motion should be correct: grain 1")
    assert told(broken.runs) == Ending("silence", "failed", "silence: no guard reported anything")


@pytest.mark.slow
@pytest.mark.compiles
def test_a_guard_of_a_compiled_backend_that_is_swallowed_is_noticed(monkeypatch):
    member = pytest.importorskip("labbook_numba.member")
    monkeypatch.setattr(member.Run, "_fail", lambda *_: None)
    (case,) = select_cases(["deep-overlap"])
    (numba,) = [platform for platform in platforms() if platform.wide and not platform.second]
    rows = judge(case, numba)
    assert "right" in [row.outcome for row in rows[:-1]]
    assert rows[-1].outcome == "failed"
    assert "no event says why" in rows[-1].figure


@pytest.mark.parametrize(("error", "outcome"), [(0.9, "right"), (1.1, "failed"), (float("nan"), "failed")])
def test_errors_are_held_against_their_limit(error, outcome):
    ending = within(Platform(broken.Toy()), "", "it", error, limited(1.0))
    assert ending.outcome == outcome


def nothing(_):
    yield from ()


def unmeasured(_):
    require(False, "nothing moved")
    yield


def lacks(_):
    raise Unsupported("grains.shape", "it has spheres only")
    yield


def refuses(_):
    raise Unsupported("numerics.precision", "it has double only")
    yield


@pytest.mark.parametrize(
    ("run", "outcome", "words"),
    [
        (nothing, "failed", "checked nothing"),
        (unmeasured, "failed", "nothing moved"),
        (lacks, "unsupported", "spheres only"),
        (refuses, "failed", "double only"),
    ],
)
def test_a_case_that_cannot_be_judged_has_failed_unless_the_backend_lacks_the_scene(run, outcome, words):
    ending = told(run)
    assert ending.outcome == outcome
    assert words in ending.figure


@pytest.mark.slow
def test_a_case_that_hangs_or_ends_its_process_has_failed_and_the_next_one_runs():
    named_backend = NamedBackend("toy", "double", "cpu")
    cases = [broken.case(broken.hangs, 5.0), broken.case(broken.crashes), broken.case(broken.runs)]
    (hung,), (crashed,), (ran,) = judge_isolated(cases, named_backend)
    assert (hung.outcome, hung.figure) == ("failed", "hung: no end after 5 s")
    assert (crashed.outcome, crashed.figure) == ("failed", "crashed: the process of the case ended")
    assert ran.figure == "silence: no guard reported anything"


# the verb


def stress(*words: str):
    return CliRunner().invoke(build(), ["stress", *words])


def test_the_list_says_what_each_case_does():
    listed = json.loads(stress("--list", "--json").stdout)
    assert [row["case"] for row in listed] == [case.name for case in CASES]
    assert all(row["what"] and row["oracle"] for row in listed)
    assert "pyramid-long" not in stress("--list", "--quick").stdout
    assert stress("no-such-case").exit_code == 2


def test_a_backend_or_precision_that_is_not_there_ends_the_program():
    assert stress("few-grains", "--backend", "no-such-backend").exit_code == 2
    assert stress("few-grains", "--backend", "toy", "--precision", "mixed").exit_code == 2


@pytest.mark.slow
def test_the_exit_status_says_whether_a_case_failed():
    """Of the toy backend, which knows neither free fall nor empty packings."""
    found = stress("few-grains", "--backend", "toy", "--json")
    assert found.exit_code == 1
    outcomes = {row["part"]: row["outcome"] for row in json.loads(found.stdout)}
    assert outcomes["one grain"] == "failed"


def test_the_page_has_every_case():
    page = (Path(__file__).parents[2] / "docs/stress.md").read_text(encoding="utf-8")
    for case in CASES:
        assert f"| `{case.name}` | {case.attempt} | {case.oracle} |" in page
