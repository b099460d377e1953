"""The benchmark measures what it says, on a small hopper."""

import pytest

from labbook.bench import engine


@pytest.mark.slow
def test_rates_are_of_the_settled_and_the_flowing_hopper():
    result = engine.run("numba", repeats=1, grains=600)
    settled, flowing = result.rates
    assert (settled.case, settled.grains) == ("fan settled", 600)
    assert 0 < flowing.grains < 600
    assert settled.low <= settled.median <= settled.high
    assert settled.median > 0.5
    assert result.speed_up > 0
    assert result.as_dict()["backend"] == "numba"
