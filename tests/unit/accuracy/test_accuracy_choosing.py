"""Numerics for a requested error: groups, regression, calibration and choice."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.optimize import root_scalar

from labbook.accuracy import (
    Calibration,
    Effects,
    Groups,
    NotMeasured,
    OutOfRange,
    bias_of,
    calibration,
    choose,
    groups,
    shipped,
)
from labbook.accuracy.calibration import PATH as SHIPS
from labbook.accuracy.calibration import extend, load, write
from labbook.accuracy.regression import Observation, curved, regress
from labbook.backend.numerics import Numerics
from labbook.filling.bed import PACKED
from labbook.plan.demand import stopping_rule
from labbook.scene import CylinderSilo, HertzMindlin, HertzPrinted, LinearSpringDashpot, Scene, Spheres, WedgeHopper
from labbook.scene.timescales import collision, largest_stable_step
from labbook.stats.effects import predict_effect
from labbook.study import define

LAW = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, rolling_friction=0.01, restitution=0.2)
SCENE = Scene(
    grains=Spheres(diameter=3e-3, density=2500, count=3000),
    contact=LAW,
    container=WedgeHopper(width=0.1, height=0.4, thickness=3.03e-3, orifice=0.03),
)
LARGEST = Groups(0.02, 0.06, "sphere", "slot", "hertz-mindlin", 0.5, 0.2, 0.01, 10.0, version=LAW.version)
EXACT = ((0.0,) * 3,) * 3


RUNS = Path(__file__).parents[3] / "benchmarks/results/2026-11-27-calibration"
SHIPPED = json.loads(SHIPS.read_text())["effects"]


def scene(slopes=(0.5, 0.0, 0.0), covariance=EXACT, **here) -> Effects:
    """What was measured in a scene like SCENE, but for `here`."""
    return Effects(replace(LARGEST, **here), slopes, covariance, 100, 0.02, "made up")


def known(slopes=(0.5, 0.0, 0.0), covariance=EXACT) -> Calibration:
    """The same in outlets of 10, 13 and 15 d."""
    return calibration([scene(slopes, covariance, ratio=ratio) for ratio in (10.0, 13.0, 15.0)])


def grouped(scene, dt, scale):
    found = groups(scene, dt, scale)
    assert found is not None
    return found


def chosen(tolerance, calibration, **kept):
    return choose(SCENE, SCENE.close(), tolerance, calibration=calibration, **kept)


def test_the_overlap_is_that_of_two_grains_under_the_pressure_of_a_bed_as_high_as_it_is_wide():
    found = grouped(SCENE, 2.5e-6, 0.1)
    pressure = PACKED * 2500 * 9.81 * 0.1
    force = pressure * 3e-3**2
    modulus = 0.1 * LAW.effective_modulus

    def press(delta):
        return 4 / 3 * modulus * math.sqrt(1.5e-3 / 2) * delta**1.5 - force

    deep = root_scalar(press, bracket=(0, 1e-3), xtol=1e-15).root
    assert found.overlap == pytest.approx(deep / 3e-3, rel=1e-9)
    assert found.step == pytest.approx(2.5e-6 / collision(SCENE.stiffened(0.1)), rel=1e-12)
    assert (found.shape, found.outlet, found.law, found.ratio) == ("sphere", "slot", "hertz-mindlin", pytest.approx(10))


def test_a_linear_spring_overlaps_by_pressure_times_d_over_its_stiffness():
    law = LinearSpringDashpot(normal_stiffness=1e4, friction=0.5, restitution=0.5)
    found = grouped(SCENE.model_copy(update={"contact": law}), 1e-6, 1.0)
    assert found.overlap == pytest.approx(PACKED * 2500 * 9.81 * 0.1 * 3e-3 / 1e4, rel=1e-12)
    assert found.law == "linear"


def runs(rng, slopes, seeds=40, within=0.01, between=0.02):
    """Runs of six settings from shared beds, and of two from beds of their own, with known slopes."""
    settings = ((0.001, 0.02), (0.001, 0.06), (0.003, 0.04), (0.005, 0.06), (0.01, 0.04), (0.02, 0.06))
    shared = [(overlap, step, 0.001) for overlap, step in settings]
    own = [(0.005, 0.04, 0.005), (0.02, 0.04, 0.02)]
    found = []
    for seed in range(seeds):
        for first, settings in ((0, shared), *((1 + k, [one]) for k, one in enumerate(own))):
            bed = rng.normal(0, math.sqrt(between**2 - within**2))
            for overlap, step, filled in settings:
                rate = math.exp(bed + slopes @ [overlap, step**2, filled] + rng.normal(0, within))
                found.append(Observation(f"{seed} {first}", filled, overlap, step, rate))
    return found


def test_regression_finds_slopes_within_its_errors_as_often_as_it_says():
    rng, slopes = np.random.default_rng(7), np.array([2.0, 5.0, -0.5])
    inside = np.zeros(4)  # of each slope, and of what acts where a bed is filled as it flows
    repeats = 300
    spread = []
    for _ in range(repeats):
        found = regress(runs(rng, slopes))
        off = found.values - slopes
        errors = [*np.diag(found.covariance), found.covariance[np.ix_([0, 2], [0, 2])].sum()]
        inside += np.abs([*off, off[0] + off[2]]) < 1.98 * np.sqrt(errors)
        spread.append((found.within, found.between))
    assert np.all(inside / repeats > 0.91)
    assert np.all(inside / repeats < 0.985)
    assert np.mean(spread, axis=0) == pytest.approx([0.01, 0.02], rel=0.05)


def bent(rng, slope, curvature, seeds=30):
    """Runs from shared beds whose ln W is slope * overlap + curvature * overlap^2."""
    found = []
    for seed in range(seeds):
        bed = rng.normal(0, 0.017)
        for overlap, step in ((0.001, 0.02), (0.001, 0.06), (0.003, 0.04), (0.006, 0.06), (0.013, 0.04), (0.013, 0.06)):
            rate = math.exp(bed + slope * overlap + curvature * overlap**2 + rng.normal(0, 0.01))
            found.append(Observation(str(seed), 0.001, overlap, step, rate))
    return found


def test_a_curved_effect_is_extrapolated_to_stiff_grains_within_its_error():
    """The slope of ln W at no overlap, by which firm grains are told: with the quadratic term within its interval as
    often as it says; a straight line through the same runs is far off it."""
    rng, repeats = np.random.default_rng(8), 200
    inside, straight = 0, []
    for _ in range(repeats):
        runs = bent(rng, 6.0, -400.0)
        found = regress(runs, curved=True)
        assert found.curvature is not None
        assert found.curvature_p < 1e-3
        inside += abs(found.values[0] - 6.0) < 1.98 * math.sqrt(found.covariance[0, 0])
        straight.append(regress(runs).values[0])
    assert 0.91 < inside / repeats < 0.99
    assert np.mean(straight) < 3


@pytest.mark.slow
def test_straight_effects_get_no_curvature_however_many_scenes_are_looked_at():
    """Twelve scenes that are straight: one or more of them are told to be curved in 5 % of repeats."""
    rng, repeats = np.random.default_rng(9), 60
    wrong = sum(any(curved([regress(bent(rng, 2.0, 0.0, 12)).curvature_p for _ in range(12)])) for _ in range(repeats))
    assert wrong <= 10, "3 in the mean, with a standard deviation of 1.7"
    assert curved([0.001, 0.03, math.nan, 0.02]) == [True, True, False, True], "0.001, 0.02, 0.03 times 3, 2, 1"
    assert curved([0.03, 0.03]) == [False, False]
    two = [one for one in bent(rng, 2.0, -400.0) if one.overlap in (0.001, 0.013)]
    assert math.isnan(regress(two).curvature_p), "two overlaps tell of no curvature"
    assert regress(two, curved=True).curvature is None


def test_a_curvature_is_in_the_bias_and_survives_its_file(tmp_path):
    """Values, errors and correlation by hand; and together with another measurement of the scene, of the step alone."""
    covariance = ((0.09, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 1e-12))
    one = replace(scene((6.0, 0.0, 0.0), covariance), curvature=(-400.0, (-20.0, 0.0, 0.0, 6400.0)))
    write(tmp_path / "own.json", [one])
    soft = Numerics(dt=1e-9, stiffness_scale=0.1)
    low, high = (grouped(SCENE, 1e-9, scale).overlap for scale in (1.0, 0.1))
    x = np.array([high - low, high**2 - low**2])
    error = math.sqrt(x @ np.array([[0.09, -20.0], [-20.0, 6400.0]]) @ x)
    only = ((math.inf, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, math.inf))
    both = calibration([one, scene((0.0, 0.0, 0.0), only)])
    for known_effects, freedom in ((load(tmp_path / "own.json"), 100), (both, 200)):
        bias = bias_of(SCENE, soft, soft, known_effects)
        assert bias.value == pytest.approx(6 * x[0] - 400 * x[1], rel=1e-6)
        assert bias.half_width == pytest.approx(stats.t.ppf(0.975, freedom) * error, rel=1e-6)


def test_what_ships_of_softness_is_what_its_runs_give():
    """By least squares with a column for each bed. Three of fourteen scenes are curved."""
    stiffness, step = np.array([1, 1, 0.1, 0.01, 0.1, 0.01]), np.array([0.02, 0.06, 0.05, 0.05, 0.05, 0.05])
    names = "accuracy-hole", "accuracy-hopper"
    effects = {name: [effect for effect in SHIPPED if effect["source"].startswith(name)] for name in names}
    assert [len(of) for of in effects.values()] == [3, 11]
    for name, of in effects.items():
        for number, effect in enumerate(of, 1):
            runs = pd.read_csv(RUNS / f"{name}-{number}.csv").dropna(subset="W_g_per_s")
            setting = runs["setting"].to_numpy()
            delta = effect["scene"]["overlap"] * (100 * stiffness[setting]) ** (-2 / 3)
            columns = [delta, step[setting] ** 2, *([delta**2] if "curvature" in effect else [])]
            design = np.column_stack([*columns, pd.get_dummies(runs["bed"])]).astype(float)
            fitted = np.linalg.lstsq(design, np.log(runs["W_g_per_s"]), rcond=None)[0]
            assert effect["slopes"][:2] == pytest.approx(fitted[:2], rel=2e-3, abs=2e-3)
            if "curvature" in effect:
                assert effect["curvature"][0] == pytest.approx(fitted[2], rel=2e-3)
    assert sum("curvature" in effect for of in effects.values() for effect in of) == 3


def test_regression_without_other_fillings_says_that_it_knows_nothing_of_them():
    some = [one for one in runs(np.random.default_rng(1), np.array([2.0, 5.0, 0.0])) if one.filled == 0.001]
    found = regress(some)
    assert (found.values[2], found.covariance[2, 2]) == (0.0, math.inf)
    alike = regress([replace(one, overlap=0.001) for one in some])
    assert (alike.values[0], alike.covariance[0, 0]) == (0.0, math.inf)
    with pytest.raises(ValueError, match="too few runs"):
        regress([replace(one, step=0.02) for one in some])


def test_the_choice_is_the_cheapest_of_all_settings_that_meet_the_error():
    slopes = (1.5, 2.0, 0.3)
    found = chosen(0.01, known(slopes))
    stated = grouped(SCENE, 1e-6, 1.0).overlap
    best = math.inf
    for scale in np.geomspace(0.01, 1, 60):
        soft = SCENE.stiffened(scale)
        limit = 0.75 * min(largest_stable_step(soft), largest_stable_step(SCENE.close().stiffened(scale)))
        for dt in np.linspace(0.005, 0.06, 40) * collision(soft):
            here = grouped(SCENE, dt, scale)
            bias = abs((slopes[0] + slopes[2]) * (here.overlap - stated) + slopes[1] * here.step**2)
            if dt <= limit and bias < 0.01:
                best = min(best, 1 / (dt * (0.01 - bias) ** 2))
    assert found.cost() == pytest.approx(best, rel=0.15)  # of the coarser grid
    assert found.cost() >= 0.97 * best
    assert found.bias.bound + found.remainder == pytest.approx(0.01, rel=1e-12)


def test_a_smaller_error_asks_for_a_stiffer_bed():
    scales = [chosen(tolerance, known((1.5, 0.0, 0.0))).stiffness_scale for tolerance in (0.1, 0.01, 0.001)]
    assert scales == sorted(scales)
    assert scales[0] < scales[-1]


def test_what_is_stated_is_kept():
    found = chosen(0.01, known(), dt=2e-6)
    assert found.dt == 2e-6
    assert chosen(0.01, known(), stiffness_scale=1.0).stiffness_scale == 1.0


def test_the_bound_has_the_error_of_the_slopes_in_it():
    covariance = ((0.04, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    soft = Numerics(dt=2e-6, stiffness_scale=0.1)
    bias = bias_of(SCENE, soft, soft, known((1.0, 0.0, 0.0), covariance))
    deeper = grouped(SCENE, 2e-6, 0.1).overlap - grouped(SCENE, 2e-6, 1.0).overlap
    assert bias.value == pytest.approx(deeper)
    assert bias.half_width == pytest.approx(1.984 * 0.2 * deeper, rel=1e-3)


def test_an_effect_that_was_never_measured_matters_only_where_it_acts():
    covariance = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, math.inf))
    hard, soft = Numerics(dt=2e-6), Numerics(dt=2e-6, stiffness_scale=0.1)
    assert math.isfinite(bias_of(SCENE, soft, hard, known(covariance=covariance)).bound)
    assert bias_of(SCENE, soft, soft, known(covariance=covariance)).bound == math.inf


def test_a_scene_that_was_not_measured_has_the_scatter_between_those_that_were_in_its_interval():
    exact = ((1e-4, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    slopes = ((3.0, 10.0), (-1.0, 15.0), (1.0, 13.0))
    apart = calibration([scene((slope, 0.0, 0.0), exact, ratio=ratio) for slope, ratio in slopes])
    soft = Numerics(dt=2e-6, stiffness_scale=0.1)
    deeper = grouped(SCENE, 2e-6, 0.1).overlap - grouped(SCENE, 2e-6, 1.0).overlap
    measured = bias_of(SCENE, soft, soft, apart)
    assert measured.value == pytest.approx(3 * deeper)
    assert measured.half_width == pytest.approx(1.984 * 0.01 * deeper, rel=1e-3)
    between = SCENE.model_copy(update={"container": SCENE.container.model_copy(update={"orifice": 0.036})})
    guessed = bias_of(between, soft, soft, apart)
    assert guessed.value == pytest.approx(deeper, rel=1e-9)
    assert guessed.half_width == pytest.approx(4.3027 * 2 * math.sqrt(4 / 3) * deeper, rel=1e-3), "of a prediction"
    two = calibration(apart.similar[0].effects[:2])
    assert bias_of(SCENE, soft, soft, two) == measured, "a scene that was measured needs no others"
    for asked in (
        lambda: bias_of(between, soft, soft, two),
        lambda: choose(between, between.close(), 0.5, calibration=two),
    ):
        with pytest.raises(NotMeasured, match="only D/d = 10, 15 calibrated, and an interval needs 3 scenes"):
            asked()


def test_measurements_of_one_scene_count_together():
    """One varied stiffness and step, whose effects it tells apart badly; another the step alone, in a firmer bed."""
    rng = np.random.default_rng(3)
    design = rng.normal(size=(40, 3))
    design[:, 1] += 0.8 * design[:, 0]
    steps = np.column_stack([np.zeros(25), rng.normal(size=25), np.zeros(25)])
    y, z = design @ [1.0, 2.0, 3.0] + rng.normal(size=40), steps @ [1.0, 2.0, 3.0] + rng.normal(size=25)
    inverse = np.linalg.inv(design.T @ design)
    first = scene(tuple(inverse @ design.T @ y), tuple(map(tuple, inverse)))
    weight = float(steps[:, 1] @ steps[:, 1])
    only = ((math.inf, 0.0, 0.0), (0.0, 1 / weight, 0.0), (0.0, 0.0, math.inf))
    second = scene((0.0, float(steps[:, 1] @ z) / weight, 0.0), only, overlap=0.004, step=0.05)
    all_at_once = np.linalg.lstsq(np.vstack([design, steps]), np.concatenate([y, z]), rcond=None)[0]
    for order in ((first, second), (second, first)):
        (alike,) = calibration(order).similar
        (both,) = alike.effects
        assert both.slopes == pytest.approx(all_at_once)
        assert both.covariance == pytest.approx(np.linalg.inv(design.T @ design + steps.T @ steps))
        assert (both.here.overlap, both.here.step, both.freedom) == (first.here.overlap, 0.05, 200)
    (alone,) = calibration([second, second]).similar[0].effects
    assert alone.source == "made up"
    assert alone.slopes == pytest.approx(second.slopes)
    assert [alone.covariance[i][i] for i in range(3)] == pytest.approx([math.inf, 0.5 / weight, math.inf])


def test_beds_whose_stiffness_was_not_varied_bound_no_overlap():
    step = ((math.inf, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, math.inf))
    firm = [scene((0.0, 1.0, 0.0), step, overlap=overlap, ratio=20 * overlap / 0.001) for overlap in (0.001, 0.003)]
    assert calibration(firm).similar[0].range("overlap") == (0.0, 0.003)
    assert calibration([*firm, scene()]).similar[0].range("overlap") == (0.0, LARGEST.overlap)


def test_the_interval_of_one_more_effect_holds_it_as_often_as_it_says():
    """Measured cases that differ by much less than the error of measurement, by as much, and by much more: at least
    92 %, less 3 standard errors of this simulation (with a prior as narrow as the errors 78 to 89 % of 3 cases)."""
    rng, repeats = np.random.default_rng(2), 400
    for cases in (3, 5, 8, 21):
        for spread in (0.1, 1.0, 3.0, 10.0):
            hits = 0
            for _ in range(repeats):
                errors = rng.uniform(0.7, 1.4, cases)
                measured = 5 + rng.normal(0, spread, cases) + rng.normal(0, errors)
                mean, half_width = predict_effect(measured.tolist(), (errors**2).tolist())
                hits += abs(rng.normal(5, spread) - mean) < half_width
            assert hits / repeats > 0.92 - 3 * math.sqrt(0.92 * 0.08 / repeats), (cases, spread)
    for few in ([], [2.0], [2.0, 3.0]):
        with pytest.raises(ValueError, match=f"at least 3 that were measured, not {len(few)}"):
            predict_effect(few, [1.0] * len(few))


def test_the_calibration_that_ships_is_of_scenes_that_differ():
    """Softness moves W by amounts of both signs: no scene's slope serves for another."""
    slopes = [one.slopes[0] for alike in shipped().similar for one in alike.effects]
    assert len(slopes) > 5
    assert min(slopes) < -2
    assert max(slopes) > 2


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"angle": math.radians(60)}, r"angle of the bottom \[deg\] = 60, calibrated: 90"),
        ({"gap": 0.0}, "eccentricity of the outlet = 1, calibrated: 0"),
    ],
)
def test_other_bottoms_than_those_that_were_measured_need_a_pilot(changed, said):
    other = SCENE.model_copy(update={"container": SCENE.container.model_copy(update=changed)})
    with pytest.raises(NotMeasured, match=said):
        choose(other, other.close(), 0.01, calibration=known())
    tilted = calibration([scene(angle=angle, eccentricity=e) for angle, e in ((45.0, 0.0), (90.0, 1.0), (70.0, 0.3))])
    assert choose(other, other.close(), 0.01, calibration=tilted).dt > 0


def test_what_was_measured_by_another_version_of_the_law_does_not_count(tmp_path):
    why = "^the law hertz-mindlin has version 2, calibrated: version 1$"
    older = calibration([scene(version=1, ratio=ratio) for ratio in (10.0, 15.0)])
    with pytest.raises(NotMeasured, match=why):
        choose(SCENE, SCENE.close(), 0.01, calibration=older)
    with pytest.raises(OutOfRange, match=why):
        bias_of(SCENE, Numerics(dt=1e-6), Numerics(dt=1e-6), older)
    laws = {effect["scene"]["law"]: effect["scene"].get("version", 1) for effect in SHIPPED}
    today = {"hertz-mindlin": HertzMindlin.version, "hertz-printed": HertzPrinted.version}
    assert laws == today, "the calibration that ships is of today's laws"
    both = calibration([scene(ratio=10.0), scene(ratio=10.0, version=1, slopes=(9.0, 0.0, 0.0))])
    assert [one.effects[0].slopes[0] for one in both.similar] == [0.5, 9.0], "they are never taken together"
    write(tmp_path / "own.json", [scene(), scene(version=1)])
    stored = json.loads((tmp_path / "own.json").read_text())["effects"]
    assert [one["scene"].get("version") for one in stored] == [2, None], "of version 1 files have always been without"
    assert [one.here.version for alike in load(tmp_path / "own.json").similar[:2] for one in alike.effects] == [2, 1]


def test_a_rotating_bottom_is_told_from_one_at_rest():
    turning = CylinderSilo(diameter=0.1, height=0.4, orifice=0.03, rotation=2.0)
    found = grouped(SCENE.model_copy(update={"container": turning}), 1e-6, 1.0)
    assert (found.outlet, found.angle, found.eccentricity) == ("hole", 90.0, 0.0)
    assert found.rotation == pytest.approx(2 * math.sqrt(0.003 / 9.81), rel=1e-3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"contact": LAW.model_copy(update={"friction": 0.3})}, "friction = 0.3, calibrated: 0.5"),
        ({"container": SCENE.container.model_copy(update={"orifice": 0.018})}, "D/d = 6, calibrated: 10 to 15"),
        ({"contact": LinearSpringDashpot(normal_stiffness=1e4, friction=0.5, restitution=0.2)}, "the law is linear"),
        ({"gravity": 0.0}, "was calibrated"),
    ],
)
def test_beyond_what_was_measured_nothing_is_chosen(change, said):
    other = SCENE.model_copy(update=change)
    with pytest.raises(OutOfRange, match=said):
        choose(other, other.close(), 0.01, calibration=known())


def test_an_error_smaller_than_what_is_known_is_refused_with_the_reason():
    covariance = ((0.0, 0.0, 0.0), (0.0, 100.0, 0.0), (0.0, 0.0, 0.0))
    with pytest.raises(OutOfRange, match=r"moves W by up to .* and 0\.01 % is asked"):
        chosen(0.0001, known(covariance=covariance))


STUDY = {
    "name": "asked",
    "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 3000},
    "contact": {"law": "hertz-mindlin", "shear_modulus": "100 MPa", "poisson_ratio": 0.25, "friction": 0.5,
                "rolling_friction": 0.01, "restitution": 0.2},
    "container": {"kind": "wedge-hopper", "width": "100 mm", "height": "400 mm", "thickness": "1.01 d",
                  "orifice": "36 mm"},
    "accuracy": {"flow_rate": "1 %"},
}  # fmt: skip


@pytest.fixture
def calibrated(monkeypatch):
    monkeypatch.setattr("labbook.accuracy.choosing.shipped", lambda: known((1.5, 2.0, 0.3)))


def test_a_study_that_asks_for_an_error_has_its_numerics_chosen(calibrated):
    point = define(STUDY).points[0]
    assert point.choice is not None
    assert (point.numerics.dt, point.numerics.stiffness_scale) == (point.choice.dt, point.choice.stiffness_scale)
    assert point.choice.tolerance == 0.01
    assert point.numerics.stiffness_scale < 1
    assert stopping_rule(define(STUDY), point).tolerance == point.choice.remainder


def test_a_study_that_asks_for_none_is_left_as_it_is(calibrated):
    plain = {key: value for key, value in STUDY.items() if key != "accuracy"}
    point = define(plain).points[0]
    assert (point.choice, point.unchosen, point.numerics.stiffness_scale) == (None, "", 1.0)


def test_stiffness_is_left_where_something_is_measured_that_was_not_calibrated(calibrated):
    point = define(STUDY | {"measure": ["flow_rate", "outlet_profiles"]}).points[0]
    assert point.choice is not None
    assert point.numerics.stiffness_scale == 1.0


def test_beyond_the_calibration_the_usual_step_is_used_and_the_reason_kept(calibrated):
    odd = define(STUDY | {"contact": STUDY["contact"] | {"restitution": 0.9}}).points[0]
    usual = {key: value for key, value in STUDY.items() if key != "accuracy"}
    usual = define(usual | {"contact": STUDY["contact"] | {"restitution": 0.9}}).points[0]
    assert odd.choice is None
    assert odd.unchosen == "restitution = 0.9, calibrated: 0.2"
    assert odd.numerics == usual.numerics


def in_both(rng, change, steps=(0.05,), slope=0.0, seeds=200, filling=None):
    """Runs in double and mixed precision from shared beds, where `mixed` changes ln W by `change`; and runs in mixed
    precision from beds that were filled in it, which changes ln W by `filling`."""
    found = []
    fillings = (False,) if filling is None else (False, True)
    for seed in range(seeds):
        for filled in fillings:
            bed = rng.normal(0, 0.02) + (filling or 0.0) * filled
            for step in steps:
                for mixed in (True,) if filled else (False, True):
                    rate = math.exp(bed + slope * step**2 + change * mixed + rng.normal(0, 0.01))
                    found.append(Observation(f"{seed} {filled}", 0.001, 0.001, step, rate, mixed, filled))
    return found


def test_runs_in_both_precisions_from_shared_beds_tell_what_mixed_does():
    found = regress(in_both(np.random.default_rng(3), 0.005))
    assert found.mixed_flow is not None
    value, variance = found.mixed_flow
    assert abs(value - 0.005) < 4 * math.sqrt(variance)
    assert math.sqrt(variance) == pytest.approx(0.01 * math.sqrt(2 / 200), rel=0.15)
    assert np.all(np.isinf(np.diag(found.covariance))), "neither the step nor an overlap was varied"
    assert found.mixed is None, "no bed was filled in mixed precision"
    again = regress(in_both(np.random.default_rng(4), 0.005, (0.02, 0.06), 3.0))
    assert again.mixed_flow is not None
    assert abs(again.mixed_flow[0] - 0.005) < 4 * math.sqrt(again.mixed_flow[1])
    assert abs(again.values[1] - 3) < 4 * math.sqrt(again.covariance[1, 1])


def test_beds_filled_in_both_precisions_tell_what_mixed_does_to_flow_and_filling_together():
    rng, off = np.random.default_rng(5), []
    for _ in range(60):
        found = regress(in_both(rng, 0.005, seeds=40, filling=-0.02))
        assert found.mixed_flow is not None
        assert found.mixed is not None
        value, variance = found.mixed
        assert variance > found.mixed_flow[1]
        off.append((value + 0.015) / math.sqrt(variance))
    assert abs(np.mean(off)) < 4 / math.sqrt(60)
    assert 0.75 < np.std(off) < 1.3, "its variance is that of its scatter"


def test_the_scatter_of_one_run_does_not_depend_on_how_many_runs_beds_have():
    """Beds that are all alike, with one run and with two: all scatter is that within beds."""
    rng = np.random.default_rng(6)
    runs = [
        Observation(f"bed {bed}", 0.001, 0.001, 0.05, math.exp(rng.normal(0, 0.02)), mixed)
        for bed in range(8000)
        for mixed in ((False,) if bed % 2 else (False, True))
    ]
    found = regress(runs)
    assert found.between == pytest.approx(0.02, rel=0.025)
    assert found.within == pytest.approx(0.02, rel=0.025)


def test_what_ships_of_mixed_precision_is_what_its_runs_give():
    """By the means of W alone: of the flow from pairs in one bed, of the filling between beds."""
    known = [effect for effect in SHIPPED if effect["source"].startswith("accuracy-precision")]
    assert len(known) == 9
    for number, effect in enumerate(known, 1):
        runs = pd.read_csv(RUNS / f"accuracy-precision-{number}.csv")
        runs["lnW"] = np.log(runs["W_g_per_s"])
        double, flowing, both = (part.set_index("seed")["lnW"] for _, part in runs.groupby("setting"))
        flow = (flowing - double).dropna()
        of_bed = (flowing - flow.mean() + double) / 2
        value, variance = effect["mixed"]
        assert value == pytest.approx(both.mean() - of_bed.mean(), abs=2e-5)
        separate = double.var() / 300 + both.var() / 300
        assert variance == pytest.approx(separate, rel=0.2), "as of runs that share no bed"


def rounded(change=0.0, error=1e-4, **here) -> Effects:
    """What mixed precision does, measured in a scene by itself."""
    unknown = tuple(tuple(math.inf if i == j else 0.0 for j in range(3)) for i in range(3))
    return Effects(replace(LARGEST, **here), (0.0, 0.0, 0.0), unknown, 100, 0.02, "made up", (change, error**2))


def three(change=0.0, **here) -> list[Effects]:
    """The same of three scenes."""
    return [rounded(change, ratio=ratio, **here) for ratio in (12.0, 13.0, 14.0)]


def with_rounding(*found: Effects, slopes=(0.5, 0.0, 0.0)) -> Calibration:
    return calibration([*(scene(slopes, ratio=ratio) for ratio in (10.0, 11.0, 15.0)), *found])


def test_mixed_precision_is_chosen_where_what_it_does_is_known_to_be_little():
    assert chosen(0.01, known()).precision == "double", "nothing is known of it"
    little = with_rounding(*three())
    assert chosen(0.01, little).precision == "mixed"
    assert chosen(0.01, with_rounding(*three()[:2])).precision == "double", "two scenes say too little of another"
    assert chosen(0.01, with_rounding(*three(0.008))).precision == "double"
    assert chosen(0.01, little, precision="double").precision == "double"
    assert chosen(0.01, known(), precision="mixed").precision == "mixed", "what is stated is kept"


def test_the_bias_of_mixed_precision_adds_to_that_of_step_and_stiffness():
    numerics = Numerics(dt=2e-6)
    plain = with_rounding(*three(0.003), slopes=(0.0, 4.0, 0.0))
    double = bias_of(SCENE, numerics, numerics, plain)
    mixed = bias_of(SCENE, numerics.model_copy(update={"precision": "mixed"}), numerics, plain)
    assert mixed.value - double.value == pytest.approx(0.003, abs=1e-5)
    assert mixed.half_width > double.half_width
    with pytest.raises(OutOfRange, match="precision mixed"):
        bias_of(SCENE, numerics.model_copy(update={"precision": "mixed"}), numerics, known())


def test_another_outlet_or_law_rounds_alike_and_rods_do_not():
    spheres = with_rounding(*three(0.003, outlet="hole", law="linear"))
    assert spheres.of(LARGEST).mixed is not None
    assert with_rounding(*three(0.003, shape="spherocylinder")).of(LARGEST).mixed is None


def test_a_pilot_of_more_points_keeps_those_that_were_measured(tmp_path):
    """Else the points of two pilots would be measured in turn for ever."""
    file = tmp_path / "own.json"
    write(file, [scene((1.0, 0.0, 0.0), ratio=10.0), scene((2.0, 0.0, 0.0), ratio=15.0)])
    extend(file, [scene((3.0, 0.0, 0.0), ratio=12.0), scene((4.0, 0.0, 0.0), ratio=15.0)])
    effects = load(file).similar[0].effects
    assert [(one.here.ratio, one.slopes[0]) for one in effects] == [(10.0, 1.0), (12.0, 3.0), (15.0, 4.0)]
    extend(tmp_path / "new.json", effects)
    assert load(tmp_path / "new.json").similar[0].effects == effects


def test_a_scene_measured_by_step_and_by_precision_keeps_both(tmp_path):
    stepped = scene((0.0, 2.0, 0.0), ((math.inf, 0, 0), (0, 0.04, 0), (0, 0, math.inf)))
    (alike,) = calibration([stepped, rounded(0.002, 1e-3), rounded(0.004, 1e-3)]).similar
    (one,) = alike.effects
    assert one.slopes[1] == pytest.approx(2.0)
    assert one.mixed == pytest.approx((0.003, 0.5e-6))
    assert one.here.step == stepped.here.step
    write(tmp_path / "own.json", alike.effects)
    (read_back,) = load(tmp_path / "own.json").similar[0].effects
    assert read_back.mixed == one.mixed
