"""Surfaces of results, and the outlet that gives a flow rate: by the law or by interpolation, within the range."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from toy_results import analyse

from labbook.cli.work import fit as verb
from labbook.results.surface import NoSurface, surface

WANTED = 0.05  # kg/s


def outlet(synthetic, W: float = WANTED) -> float:
    """D [m] at which Beverloo's law gives W, by the law written backwards."""
    scene = synthetic.scene()
    unit = synthetic.C * scene.grains.density * math.sqrt(scene.gravity) * scene.container.thickness
    return (W / unit) ** (2 / 3) + synthetic.K * scene.grains.diameter


def test_the_law_is_used_where_the_points_allow_it(analysis, synthetic):
    found = surface(analysis)
    assert found.method.startswith(("Beverloo fitted to 8 points, lack of fit p = ", "Janda fitted to 8 points"))
    design = found.inverse("50 g/s")
    assert design.low < outlet(synthetic) < design.high
    assert design.value == pytest.approx(outlet(synthetic), abs=design.high - design.low)
    assert design.high - design.low < 0.01 * design.value
    value, low, high = found.predict(design.value)
    assert value[0] == pytest.approx(WANTED, rel=1e-4)
    assert low[0] < WANTED < high[0]
    ends = [found.predict(end) for end in (design.low, design.high)]
    assert [ends[0][2][0], ends[1][1][0]] == pytest.approx([WANTED] * 2, rel=1e-3)


def test_it_is_interpolated_where_the_law_misses_or_there_is_none(analysis, synthetic):
    alone = replace(analysis, study=replace(analysis.study, fit=()))
    found = surface(alone)
    assert found.method == "interpolated between 8 values, with 24 beds"
    design = found.inverse(WANTED)
    assert design.low < outlet(synthetic) < design.high
    # W of 24 runs, each with an error of a percent or two
    assert 0.001 < (design.high - design.low) / design.value < 0.03


def test_a_law_that_misses_is_named(column, synthetic):
    study, _ = column

    class Wavy(synthetic.FinishedDouble):
        def data(self):
            data = super().data()
            table = dict(data.tables["crossing"])
            table["time"] = table["time"] * (1 + 0.1 * (-1) ** self.point.index)
            return replace(data, tables={**data.tables, "crossing": table})

    found = analyse(study, [Wavy(point, seed) for point in study.points for seed in (1, 2, 3)])
    made = surface(found)
    assert "Beverloo misses the points, p = " in made.method


def test_clogged_points_are_left_out_and_named(column, synthetic):
    study, finished = column
    runs = [one for one in finished if one.point.index > 0]
    first = study.points[0]
    runs += [synthetic.FinishedDouble(first, seed, "clogged" if seed == 1 else "emptied") for seed in (1, 2, 3)]
    found = surface(analyse(study, runs))
    assert found.low == 0.021
    (note,) = found.notes
    assert note.startswith("D = 18 mm is left out: 1 of 3 runs clogged")


def test_an_end_that_the_range_does_not_bound_is_named(analysis, synthetic):
    """The flow of 60 mm, which is the widest outlet: the interval goes on beyond it."""
    alone = replace(analysis, study=replace(analysis.study, fit=()))
    W = 0.9999 * surface(alone).predict(0.06)[0][0]
    design = surface(alone).inverse(float(W))
    assert design.high == math.inf
    assert "to beyond the swept range) gives W = " in design.sentence


@pytest.mark.parametrize(("wanted", "says"), [
    ("500 g/s", r"flow_rate = 500 g/s is not reached: flow_rate is .* at D = 18 to 60 mm; sweep a wider range"),
    ("1 g/s", "is not reached"),
])  # fmt: skip
def test_nothing_is_said_beyond_the_swept_range(analysis, wanted, says):
    with pytest.raises(NoSurface, match=says):
        surface(analysis).inverse(wanted)
    with pytest.raises(NoSurface, match="D = 61 mm is outside of the range"):
        surface(analysis).predict(["20 mm", "61 mm"])


def test_few_points_or_one_bed_give_none(column):
    study, finished = column
    few = analyse(replace(study, fit=()), [one for one in finished if one.point.index < 3])
    with pytest.raises(NoSurface, match="3 settings are too few"):
        surface(few)
    alone = analyse(replace(study, fit=()), [one for one in finished if one.seed == 1])
    with pytest.raises(NoSurface, match="of one bed"):
        surface(alone)


def test_other_swept_keys_have_to_be_stated(synthetic):
    angles = (math.pi / 6, math.pi / 2)
    points = [synthetic.point(k, D, angles[k % 2]) for k, D in enumerate(np.repeat([0.02, 0.03, 0.04, 0.05], 2))]
    study = synthetic.study_of(points, reference=None)
    found = analyse(study, [synthetic.FinishedDouble(point, seed) for point in points for seed in (1, 2)])
    with pytest.raises(LookupError, match=r"container.orifice, container.angle: say which one"):
        surface(found)
    with pytest.raises(LookupError, match=r"give a value of container.angle"):
        surface(found, over="orifice")
    with pytest.raises(LookupError, match="no point has these values"):
        surface(found, over="orifice", at={"angle": "31 deg"})
    made = surface(found, over="orifice", at={"angle": "30 deg"})
    assert len(made.points) == 4
    with pytest.raises(LookupError, match="does not sweep width"):
        surface(found, over="width")


def test_the_verb_prints_the_answer(analysis, capsys):
    found = SimpleNamespace(
        inverse=lambda quantity, value, over, at: surface(analysis, quantity, over, at).inverse(value)
    )
    found.study = analysis.study
    verb.answer(found, "flow_rate = 50 g/s", None, [], as_json=True)  # pyright: ignore[reportArgumentType]
    answer = json.loads(capsys.readouterr().out)
    assert answer["key"] == "container.orifice"
    assert answer["low"] < answer["value"] < answer["high"]
    verb.answer(found, "flow_rate = 50 g/s", None, [], as_json=False)  # pyright: ignore[reportArgumentType]
    assert "mm (95 %: " in capsys.readouterr().out
    with pytest.raises(typer.Exit):
        verb.answer(found, "flow_rate = 500 g/s", None, [], as_json=False)  # pyright: ignore[reportArgumentType]
    assert "Error: flow_rate = 500 g/s is not reached" in capsys.readouterr().err
    with pytest.raises(typer.BadParameter):
        verb.answer(found, "flow_rate 50 g/s", None, [], as_json=False)  # pyright: ignore[reportArgumentType]
