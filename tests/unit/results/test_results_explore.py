"""A quantity over all swept keys: values, inverse, what matters, what to run next, and where nothing is answered."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from toy_results import analyse

from labbook.cli.work import fit as verb
from labbook.results.explore import Factor, explore, inverse, swept_keys
from labbook.results.surface import NoSurface, surface

ORIFICES, ANGLES = (0.018, 0.024, 0.03, 0.045), (math.pi / 6, math.pi / 3, math.pi / 2)
STEEP = 0.3
"""Relative rise of the flow rate from the flattest to the steepest bottom."""


@pytest.fixture(scope="module")
def steeper(synthetic):
    """Runs whose flow rate is Beverloo's, times what a steeper bottom adds, with a scatter of 2 % of its own: that of
    the double is the same at all angles."""

    class Steeper(synthetic.FinishedDouble):
        def __init__(self, *given, cost: float = 10.0, **more):
            super().__init__(*given, **more)
            object.__setattr__(self, "entry", replace(self.entry, device_time=cost, filling_time=2.0))

        def data(self):
            data = super().data()
            table = dict(data.tables["crossing"])
            noise = 1 + 0.02 * np.random.default_rng([7, self.point.index, self.seed]).standard_normal()
            table["time"] = table["time"] / steeper_by(self.point.at["container.angle"]) / noise
            return replace(data, tables={**data.tables, "crossing": table})

    return Steeper


def steeper_by(angle: float) -> float:
    return 1 + STEEP * 1.5 * (1 - angle / (math.pi / 2))


def true_flow(synthetic, D: float, angle: float) -> float:
    return synthetic.beverloo(synthetic.scene(D, angle)) * steeper_by(angle)


@pytest.fixture(scope="module")
def plane(synthetic, steeper):
    """Four outlets, three angles, three beds; the smallest outlet clogs over the flat bottom."""
    points = [synthetic.point(k, D, angle) for k, (D, angle) in enumerate((D, a) for D in ORIFICES for a in ANGLES)]
    study = synthetic.study_of(points, reference=None)

    def outcome(point) -> str:
        return (
            "clogged"
            if (point.at["container.orifice"], point.at["container.angle"]) == (0.018, ANGLES[2])
            else "emptied"
        )

    return analyse(study, [steeper(one, seed, outcome(one)) for one in points for seed in (1, 2, 3)])


def test_values_are_those_of_the_law_between_the_points(plane, synthetic):
    found = explore(plane)
    assert found.keys == ("container.orifice", "container.angle")
    assert [one.logarithmic for one in found.factors] == [True, False]
    held = []
    for D, angle in ((0.02, 0.7), (0.027, 0.9), (0.036, 1.3), (0.04, 0.55), (0.0225, 1.2)):
        value, low, high = found.predict({"orifice": D, "angle": angle})
        held.append(low <= true_flow(synthetic, D, angle) <= high)
        assert value == pytest.approx(true_flow(synthetic, D, angle), rel=0.05)
        assert (high - low) / value < 0.2
    assert sum(held) >= 4
    text = found.predict({"orifice": "27 mm", "angle": "50 deg"})
    assert text == pytest.approx(found.predict({"orifice": 0.027, "angle": math.radians(50)}), rel=1e-12)


def test_the_inverse_is_the_value_of_one_key_at_the_others(plane, synthetic):
    found = explore(plane)
    wanted = true_flow(synthetic, 0.028, 1.0)
    design = found.inverse(wanted, "orifice", {"angle": 1.0})
    assert design.low < 0.028 < design.high
    value, low, high = found.predict({"orifice": design.value, "angle": 1.0})
    assert value == pytest.approx(wanted, rel=1e-3)
    assert low < wanted < high
    assert design.sentence.startswith("D = ")
    other = found.inverse(wanted, "angle", {"orifice": 0.028})
    assert other.low < 1.0 < other.high
    with pytest.raises(NoSurface, match=r"flow_rate = 1000 g/s is not reached: flow_rate is .* at angle = 57"):
        found.inverse("1 kg/s", "orifice", {"angle": 1.0})
    with pytest.raises(LookupError, match=r"give a value of container.angle"):
        found.inverse(wanted, "orifice")


def test_clogged_points_are_left_out_and_nothing_is_answered_there(plane):
    found = explore(plane)
    (left,) = found.left_out
    assert left.at["container.orifice"] == 0.018
    assert found.notes == ("D = 18 mm, angle = 90 deg is left out: 3 of 3 runs clogged",)
    with pytest.raises(NoSurface, match="is not between the points"):
        found.predict({"orifice": "18 mm", "angle": "85 deg"})
    with pytest.raises(NoSurface, match="is not between the points"):
        found.predict({"orifice": "46 mm", "angle": "60 deg"})
    design = found.inverse(0.05, "orifice", {"angle": "90 deg"})
    assert design.value > 0.018


def test_what_matters_is_the_outlet(plane, synthetic):
    """Angle: the flow at 30 deg over that at 90 deg is 1.3; outlet: that of Beverloo's law at its ends."""
    outlet, angle, together = explore(plane).influences
    assert outlet.share > 0.9 > 0.1 > angle.share
    assert outlet.low > angle.high
    assert together.share < 0.02
    assert explore(plane).verdict == "Orifice D matters most."
    assert angle.change_low < 1 / 1.3 - 1 < angle.change_high
    ratio = synthetic.beverloo(synthetic.scene(0.045)) / synthetic.beverloo(synthetic.scene(0.018))
    assert outlet.change_low < ratio - 1 < outlet.change_high


def test_the_next_runs_are_the_best_per_second(plane, synthetic, steeper):
    found = explore(plane)
    proposals = found.next_runs
    assert 1 <= len(proposals) <= 3
    for one in proposals:
        assert one.beds == 6
        assert one.half_width_then < one.half_width
        assert 0.02 < one.gain < 1
        assert one.seconds == pytest.approx(12.0 * one.runs, rel=1e-6)
        found.predict(one.at)
    # with dear runs at wide outlets the proposals move to narrow ones
    study, dear = plane.study, []
    for result in plane.points:
        cost = 1e4 if result.at["container.orifice"] > 0.02 else 1.0
        dear += [steeper(result.point, run.seed, run.outcome, cost=cost) for run in result.runs]
    narrow = explore(analyse(study, dear)).next_runs
    assert max(one.at["container.orifice"] for one in narrow) < max(one.at["container.orifice"] for one in proposals)


def test_one_key_answers_by_its_law(analysis):
    found = explore(analysis)
    assert found.method == surface(analysis).method
    value, low, high = surface(analysis).predict("40 mm")
    assert found.predict({"orifice": "40 mm"}) == (value[0], low[0], high[0])
    assert found.inverse("50 g/s", "orifice") == surface(analysis).inverse("50 g/s")
    assert found.verdict == ""


def test_values_between_the_swept_ones_are_answered_by_the_surface(plane, synthetic):
    """`labbook fit --want --over --at`: the points of an angle that was run, else the surface."""
    wanted = true_flow(synthetic, 0.028, math.radians(45))
    design = inverse(plane, "flow_rate", wanted, "orifice", {"angle": "45 deg"})
    assert design.low < 0.028 < design.high
    assert "smooth surface" in design.method
    of_points = inverse(plane, "flow_rate", wanted, "orifice", {"angle": "60 deg"})
    assert "smooth surface" not in of_points.method


def test_other_keys_have_to_be_stated(plane):
    keys, choices = swept_keys(plane.points)
    assert (keys, choices) == (("container.orifice", "container.angle"), ())
    worded = [
        replace(one, at={**one.at, "contact.law": "linear" if one.point.index % 2 else "hertz"}) for one in plane.points
    ]
    results = replace(plane, points=tuple(worded))
    with pytest.raises(LookupError, match=r"give a value of contact.law"):
        explore(results)
    assert len(explore(results, at={"law": "linear"}).points) == 6
    with pytest.raises(NoSurface, match="no_such is known at fewer than two values"):
        explore(plane, "no_such")


@pytest.mark.parametrize(
    ("key", "values", "logarithmic"),
    [
        ("container.orifice", [0.01, 0.02, 0.03], True),
        ("contact.friction", [0.1, 0.2, 0.4, 0.8], True),
        ("contact.friction", [0.1, 0.3, 0.5], False),
        ("container.angle", [0.5, 1.0], False),
        ("container.rotation", [0.0, 1.0, 2.0], False),
    ],
)
def test_keys_are_scaled_as_they_are_swept(key, values, logarithmic):
    factor = Factor.of(key, values)
    assert factor.logarithmic == logarithmic
    assert factor.scaled(np.array([values[0], values[-1]])) == pytest.approx([-1, 1])
    assert factor.value(factor.scaled(np.array(values))) == pytest.approx(values)


def test_the_verb_prints_it_for_people_and_programs(plane, capsys, monkeypatch):
    results = SimpleNamespace(explore=lambda quantity, at: explore(plane, quantity, at))
    monkeypatch.setattr("labbook.results.explore.DesignSurface.next_study", "name: synthetic-next\n")
    verb.show_explored(results, "flow_rate", [], as_json=True)  # pyright: ignore[reportArgumentType]
    answer = json.loads(capsys.readouterr().out)
    assert [one["key"] for one in answer["influences"]] == ["container.orifice", "container.angle", ""]
    assert answer["influences"][2]["change"] is None
    assert answer["next"][0]["per_second"] > 0
    verb.show_explored(results, "flow_rate", [], as_json=False)  # pyright: ignore[reportArgumentType]
    text = capsys.readouterr().out
    for words in ("What matters", "Orifice D matters most.", "What to run next", "gain per second", "synthetic-next"):
        assert words in text
