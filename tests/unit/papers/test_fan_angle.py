import math

import pytest
from scipy.special import beta

from labbook.papers.fan2023.laws import brown, rose_tanaka

DEGREE = math.pi / 180


def test_brown_of_a_flat_bottom_is_one_and_its_integral_the_known_one():
    """int_0^{pi/2} sqrt(cos x) dx = B(3/4, 1/2)/2 = 1.198."""
    assert brown(math.pi / 2) == 1
    steep = 1e-4
    assert brown(steep) == pytest.approx(steep**-0.5 / (beta(0.75, 0.5) / 2), rel=1e-6)


@pytest.mark.parametrize("angle", [15, 30, 55, 75])
def test_brown_agrees_with_a_sum(angle):
    n = 200_000
    total = sum(math.sqrt(math.cos((k + 0.5) * angle * DEGREE / n)) for k in range(n)) * angle * DEGREE / n
    expected = total / math.sin(angle * DEGREE) ** 1.5 / (beta(0.75, 0.5) / 2)
    assert brown(angle * DEGREE) == pytest.approx(expected, rel=1e-8)


def test_brown_of_15_degrees_is_that_of_the_paper():
    """C(15 deg)/C(90 deg) would be 1.65."""
    assert brown(15 * DEGREE) == pytest.approx(1.65, abs=0.005)


def test_rose_tanaka_joins_one_at_the_stagnant_zone():
    friction = 26.6 * DEGREE
    edge = math.pi / 2 - friction
    assert rose_tanaka(edge * (1 - 1e-9), friction) == pytest.approx(1, abs=1e-6)
    assert rose_tanaka(edge * 1.01, friction) == 1
    expected = (math.tan(15 * DEGREE) * math.tan(friction)) ** -0.35
    assert rose_tanaka(15 * DEGREE, friction) == pytest.approx(expected)


@pytest.mark.parametrize(("law", "arguments"), [(brown, (0.0,)), (brown, (2.0,)), (rose_tanaka, (0.5, 0.0))])
def test_impossible_angles_are_refused(law, arguments):
    with pytest.raises(ValueError, match="between 0 and 90 deg"):
        law(*arguments)
