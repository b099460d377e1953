"""Campaigns: on which results a proposal rests, whatever the timing; what is kept; the three built-in strategies."""

import math
from collections.abc import Sequence
from typing import ClassVar

import pytest

from labbook.campaign import (
    Assignment,
    Campaign,
    Generation,
    History,
    PreciseRun,
    Proposal,
    Replicates,
    Strategy,
    Trial,
)
from labbook.campaign.campaign import Proposed, with_proposal
from labbook.campaign.precise import HALF_WIDTH
from labbook.stats import StoppingRule, Tolerance


class Counting(Strategy):
    """Proposes one point a generation, at the number of runs that it was shown; ends after `last` of them."""

    name: ClassVar[str] = "counting"

    last: int = 4
    waits: bool = False

    def propose(self, history: History) -> Proposal:
        if self.waits and history.pending:
            return Proposal.wait()
        if history.number == self.last:
            return Proposal.end("enough")
        known = len(list(history.trials))
        return Proposal((Assignment({"x": float(history.number), "known": float(known)}),), f"{known} runs are known")


class Ahead(Counting):
    name: ClassVar[str] = "ahead"
    ahead: ClassVar[int] = 0


def runs(generation: Generation) -> tuple[Trial, ...]:
    """A run of each assignment; keys in no order."""
    return tuple(
        Trial(one.at, 1, f"key {hash(one.at['x']) % 7} {one.at['x']}", "finished", {"flow_rate": float(one.at["x"])})
        for one in generation.assignments
    )


def known(campaign: Campaign) -> list[float]:
    return [float(one.at["known"]) for one in campaign.assignments]


def test_a_generation_is_in_flight_while_the_next_is_proposed():
    campaign, done = Campaign(Counting(), None), set[int]()

    def evaluate(generation: Generation):
        return runs(generation) if generation.number in done else None

    assert campaign.advance(evaluate)
    assert len(campaign.generations) == 2, "the second is proposed before any run is done"
    assert not campaign.advance(evaluate), "two are in flight"
    done.add(0)
    assert campaign.advance(evaluate)
    assert len(campaign.generations) == 3
    done |= {1, 2, 3}
    campaign.advance(evaluate)
    assert campaign.ended == "enough"
    assert known(campaign) == [0, 0, 1, 2], "each rests on all but the generation before it"


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (1, 0, 3, 2), (3, 2, 1, 0)])
@pytest.mark.parametrize(("strategy", "expected"), [
    (Counting(), [0, 0, 1, 2]), (Counting(waits=True), [0, 1, 2, 3]), (Ahead(), [0, 1, 2, 3]),
])  # fmt: skip
def test_timing_never_enters(order, strategy, expected):
    """Whichever generation is done first, and however late it is looked at, the same is proposed."""
    campaign, done = Campaign(strategy, None), set[int]()
    for number in order:
        campaign.advance(lambda generation: runs(generation) if generation.number in done else None)
        done.add(number)
    campaign.advance(runs)
    assert known(campaign) == expected
    at_once = Campaign(strategy, None)
    at_once.advance(runs)
    assert at_once.generations == campaign.generations


def test_what_is_in_flight_is_shown_without_its_results():
    shown: list[History] = []

    class Looking(Counting):
        name: ClassVar[str] = "looking"

        def propose(self, history: History) -> Proposal:
            shown.append(history)
            return super().propose(history)

    Campaign(Looking(), None).advance(runs)
    assert [len(one.generations) for one in shown] == [0, 0, 1, 2, 3]
    assert all(generation.trials is None for one in shown for generation in one.pending)
    assert all(list(one.generations) == sorted(one.generations, key=lambda g: g.number) for one in shown)


def test_the_first_proposal_that_is_kept_counts():
    """Another process has kept a proposal of its own before ours comes."""
    theirs = Proposal((Assignment({"x": 7.0, "known": 0.0}),), "theirs")
    held = with_proposal(Proposed(), 0, theirs)

    def keep(number: int, proposal: Proposal) -> Proposed:
        nonlocal held
        held = with_proposal(held, number, proposal)
        return held

    campaign = Campaign(Counting(), None, keep=keep)
    campaign.advance(lambda generation: None)
    assert [one.reason for one in campaign.generations] == ["theirs", "0 runs are known"]
    assert campaign.assignments[0].at["x"] == 7


def test_a_strategy_that_waits_for_nothing_or_proposes_nothing_is_an_error():
    class Idle(Counting):
        name: ClassVar[str] = "idle"

        def propose(self, history: History) -> Proposal:
            return Proposal.wait() if self.waits else Proposal((), "nothing")

    with pytest.raises(ValueError, match="the strategy idle waits"):
        Campaign(Idle(waits=True), None).advance(runs)
    with pytest.raises(ValueError, match="the strategy idle proposes no assignments"):
        Campaign(Idle(), None).advance(runs)


def test_more_replicates_of_a_point_are_no_new_point():
    generations = (
        Generation(0, (Assignment({"x": 1.0}, 2), Assignment({"x": 2.0}, 2)), ""),
        Generation(1, (Assignment({"x": 1.0}, 5),), ""),
    )
    campaign = Campaign(Counting(), None, Proposed(generations))
    assert campaign.assignments == [Assignment({"x": 1.0}, 5), Assignment({"x": 2.0}, 2)]


def test_a_value_that_was_computed_in_two_ways_is_one_point():
    """0.1 + 0.2 is not 0.3 to the last digit, and is the same outlet."""
    generations = (
        Generation(0, (Assignment({"x": 0.3}, 2),), ""),
        Generation(1, (Assignment({"x": 0.1 + 0.2}, 3),), ""),
    )
    assert Campaign(Counting(), None, Proposed(generations)).assignments == [Assignment({"x": 0.3}, 3)]
    trials = tuple(Trial({"x": x}, seed, str(seed), "finished", {"q": 1.0}) for seed, x in ((1, 0.3), (2, 0.1 + 0.2)))
    assert History(None, (Generation(0, (), "", trials),)).values("q") == [({"x": 0.3}, [1.0, 1.0])]


def test_values_are_by_point_and_seed():
    trials = (
        Trial({"x": 1.0}, 2, "a", "finished", {"flow_rate": 4.0}),
        Trial({"x": 1.0}, 1, "b", "finished", {"flow_rate": 3.0}),
        Trial({"x": 2.0}, 1, "c", "clogged", {}),
        Trial({"x": 3.0}, 1, "d", "finished", {"flow_rate": 0.0}),
    )
    history = History(None, (Generation(0, (), "", trials),))
    assert history.values("flow_rate") == [({"x": 1.0}, [3.0, 4.0]), ({"x": 2.0}, []), ({"x": 3.0}, [0.0])]
    # of 3 and 4: mean 3.5, standard error 0.5, and t of one degree of freedom is 12.706
    (at, mean), (zero, _) = history.pooled("flow_rate")
    assert (at, zero) == ({"x": 1.0}, {"x": 3.0})
    assert (mean.value, mean.error) == (3.5, 0.5)
    assert mean.half_width == pytest.approx(0.5 * 12.7062, rel=1e-5)


@pytest.mark.parametrize(
    ("half_width", "bias", "is_kept"), [(0.01, 0.0, True), (0.008, 0.002, True), (0.009, 0.002, False)]
)
def test_the_sum_of_bias_and_half_width_is_what_is_tolerated(half_width, bias, is_kept):
    assert Tolerance(0.01, bias).met(half_width) is is_kept


def one_point(values: Sequence[float | None]) -> History:
    trials = tuple(
        Trial({"x": 1.0}, seed, f"key {-seed}", "finished", {} if value is None else {"flow_rate": value})
        for seed, value in enumerate(values, 1)
    )
    return History(None, (Generation(0, (Assignment({"x": 1.0}, len(values)),), "", trials),), (), 1)


CLOSE = [1.0, 1.0001, 0.9999, 1.0, 1.0001]


def test_replicates_are_added_until_the_flow_rate_is_known():
    rule = StoppingRule(0.02, 3, 20)
    first = Replicates(rule=rule).propose(one_point([1.0, 1.0001, 0.9999]))
    assert first.assignments[0].replicates == 5, "no look at fewer, however close they are"
    few = Replicates(rule=rule).propose(one_point([0.9, 1.0, 1.1, 0.9, 1.0, 1.1]))
    assert few.state == "go"
    assert few.assignments[0].replicates == 8, "at most a third at a time"
    assert few.decision is not None
    enough = Replicates(rule=rule).propose(one_point(CLOSE))
    assert enough.state == "end"
    assert "with 5 replicates" in enough.reason
    hopeless = Replicates(rule=rule).propose(one_point([None] * 6))
    assert hopeless.reason.startswith("none of 6 runs has a flow rate")
    capped = Replicates(rule=StoppingRule(0.02, 3, 3)).propose(one_point([0.9, 1.0, 1.1]))
    assert "accuracy.max_replicates allows no more" in capped.reason


def test_a_forecast_of_replicates_that_was_wrong_is_reported():
    rule = StoppingRule(0.02, 3, 50)
    proposal = Replicates(rule=rule, scatter=0.1).propose(one_point(CLOSE))
    assert f"({rule.forecast(0.1)} were expected" in proposal.reason
    assert "expected" not in Replicates(rule=rule).propose(one_point(CLOSE)).reason


@pytest.mark.parametrize(("half_width", "state"), [(math.nan, "go"), (0.02, "go"), (0.01, "end")])
def test_a_fed_run_goes_on_until_it_is_precise(half_width, state):
    numbers = {} if math.isnan(half_width) else {HALF_WIDTH: half_width}
    look = Generation(0, (Assignment({}),), "", (Trial({}, 1, "key", "going on", numbers),))
    assert PreciseRun(error=0.01).propose(History(None, (look,), (), 1)).state == state


def nested_point(beds: Sequence[Sequence[float | None]]) -> History:
    """A point with the flow rates of the discharges of each bed."""
    trials = tuple(
        Trial({"x": 1.0}, seed, f"{seed} {k}", "clogged", {} if value is None else {"flow_rate": value}, k)
        for seed, bed in enumerate(beds, 1)
        for k, value in enumerate(bed, 1)
    )
    return History(None, (Generation(0, (Assignment({"x": 1.0}, len(beds), len(beds[0])),), "", trials),), (), 1)


def test_the_values_of_a_point_are_means_of_beds():
    history = nested_point([[1.0, 3.0], [None, 4.0], [None, None]])
    assert history.values("flow_rate") == [({"x": 1.0}, [2.0, 4.0])]
    assert history.beds("flow_rate") == [({"x": 1.0}, {1: [1.0, 3.0], 2: [4.0]})]


def test_a_stated_number_of_discharges_stays():
    beds = [[0.9, 1.0], [1.0, 1.1], [1.0, 0.9], [0.9, 1.1], [1.0, 1.0]]
    proposal = Replicates(rule=StoppingRule(0.02, 3, 20)).propose(nested_point(beds))
    assert proposal.assignments == (Assignment({"x": 1.0}, 6, 2),)
    assert "5 replicates of 2 discharges: 6 replicates of 2 discharges in all" in proposal.reason


def test_dear_fillings_are_discharged_again_and_cheap_ones_are_not():
    scattered = nested_point([[0.95], [1.0], [1.05], [0.95], [1.05]])
    rule = StoppingRule(0.02, 3, 50)
    dear = Replicates(rule=rule, filling=10.0).propose(scattered)
    assert dear.assignments == (Assignment({"x": 1.0}, 6, 2),), "one discharge more at a time, of all beds"
    assert "82 % of the variance of W is made in the flow, 18 % in the bed (as in other scenes)" in dear.reason
    assert "as a filling takes 10 times a discharge" in dear.reason
    cheap = Replicates(rule=rule, filling=0.05).propose(scattered)
    assert cheap.assignments == (Assignment({"x": 1.0}, 6, 1),)
    assert "1 discharge a bed is cheapest" in cheap.reason


def test_discharges_are_added_to_as_many_beds_as_the_cap_allows():
    """At the cap the error may still be reached by further discharges; where it cannot, nothing more is made."""
    beds = [[1.0 + 0.01 * (-1) ** seed] for seed in range(6)]
    # half width of 6 beds 1.4 %; with two discharges of each 0.77 of that, with three 0.67
    for error, wanted in ((0.012, 2), (0.0105, 2), (0.0001, None)):
        proposal = Replicates(rule=StoppingRule(error, 3, 6), filling=2.0).propose(nested_point(beds))
        assert [one.discharges for one in proposal.assignments] == ([] if wanted is None else [wanted])
    assert "accuracy.max_replicates allows no more" in proposal.reason


def test_a_proposal_always_adds_runs_or_ends():
    """Also where the scatter of runs tells less than that of the means of beds does."""
    rule = StoppingRule(0.02, 3, 50)
    beds = [[one] * 3 for one in (0.97, 1.0, 1.03, 0.97, 1.03)]
    proposal = Replicates(rule=rule, filling=2.0).propose(nested_point(beds))
    (assigned,) = proposal.assignments
    assert (assigned.replicates, assigned.discharges) > (5, 3)
