import math

import pytest

from labbook.stats.choice import aicc, best_laws, deviance


def test_aicc_by_hand():
    # n = 8 points, 2 parameters, so K = 3: 8 ln(4/8) + 6 + 24/4.
    assert aicc(4.0, 8, 2) == pytest.approx(8 * math.log(0.5) + 12)


@pytest.mark.parametrize(("points", "parameters"), [(4, 2), (5, 3), (3, 3)])
def test_too_few_points_have_no_aicc(points, parameters):
    assert math.isnan(aicc(1.0, points, parameters))
    assert not math.isnan(aicc(1.0, parameters + 3, parameters))


def test_to_beat_a_law_takes_a_difference_of_four():
    assert best_laws({"beverloo": (10.0,), "janda": (14.0,)}) == ("beverloo",)
    assert best_laws({"beverloo": (14.5,), "janda": (10.0,)}) == ("janda",)
    assert best_laws({"beverloo": (10.0,), "janda": (13.9,)}) == ("beverloo", "janda")


def test_a_law_is_beaten_by_every_criterion_or_not_at_all():
    assert best_laws({"beverloo": (10.0, 1.0), "janda": (20.0, 2.0)}) == ("beverloo", "janda")
    assert best_laws({"beverloo": (10.0, 1.0), "janda": (20.0, 5.0)}) == ("beverloo",)


def test_a_law_far_behind_is_out_though_others_are_undecided():
    assert best_laws({"power": (26.3,), "exponential": (47.9,), "beverloo": (28.0,)}) == ("power", "beverloo")


def test_a_law_without_aicc_beats_nothing_and_is_not_beaten():
    assert best_laws({"beverloo": (1.0, 1.0), "janda": (math.nan, 9.0), "power": (9.0, 9.0)}) == ("beverloo", "janda")


def test_one_law_is_no_choice_and_none_is_an_error():
    assert best_laws({"beverloo": (3.0,)}) == ("beverloo",)
    with pytest.raises(ValueError, match="no law"):
        best_laws({})


def test_deviance_is_that_of_normal_errors_of_free_size():
    # -2 ln L of n normal residuals at their best sigma, up to a constant: n ln(sigma^2).
    assert deviance(2.0, 8) - deviance(1.0, 8) == pytest.approx(8 * math.log(2))
    assert deviance(0.0, 8) == -math.inf


def test_two_exact_fits_are_undecided():
    assert best_laws({"beverloo": (-math.inf,), "janda": (-math.inf,)}) == ("beverloo", "janda")


def test_negative_sum_of_squares_is_refused():
    with pytest.raises(ValueError, match="negative"):
        aicc(-1.0, 8, 2)
