"""The benchmark measures what it says, on a small hopper."""

import pytest

from labbook.bench import engine


@pytest.mark.slow
def test_rates_are_of_the_settled_and_the_flowing_hopper():
    result = engine.run("numba", repeats=1, grains=600, boxes=(500,))
    settled, flowing, *mixed, stack = result.rates
    assert (settled.case, settled.grains) == ("fan settled", 600)
    assert 0 < flowing.grains < 600
    assert settled.low <= settled.median <= settled.high
    assert settled.median > 0.5
    assert {rate.precision for rate in mixed} == {"mixed"}
    assert (stack.case, stack.grains) == ("box at rest", 500)
    assert len({rate.case for rate in result.ablations}) == 5
    assert result.speed_up > 0
    assert 0 < result.starting.cached < result.starting.compiled
    assert result.starting.cached < result.starting.first_step
    assert result.as_dict()["backend"] == "numba"
