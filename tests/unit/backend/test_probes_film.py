"""Where the frames of a film lie."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labbook.backend.probes import UNEVEN, Film, Sample, describe_probe, parse_probe


@given(st.floats(1.0, 700.0), st.floats(1e-7, 1e-3), st.lists(st.integers(1, 900), min_size=1, max_size=6))
def test_frames_are_at_the_nearest_steps_however_a_run_is_split(steps, dt, parts):
    film = Film(steps * dt)
    found, step = list(film.steps(dt, 0, 0)), 0
    for part in parts:
        found += film.steps(dt, step + 1, step + part)
        step += part
    wanted = [round(number * film.every / dt) for number in range(int(step / steps) + 2)]
    assert found == [at for at in wanted if at <= step]
    for number, at in enumerate(found):
        assert abs(at * dt - number * film.every) <= dt / 2 * (1 + 1e-6)


@given(st.floats(0.6, 100.0))
def test_how_uneven_they_are_is_told(steps):
    """By all times between two frames of a film of many."""
    film, dt = Film(steps * 1e-5), 1e-5
    at = list(film.steps(dt, 0, 5000))
    apart = [b - a for a, b in pairwise(at)]
    worst = max(abs(one - steps) for one in apart) / steps
    assert worst <= film.uneven(dt) + 1e-9
    if steps >= 1 / UNEVEN:
        assert film.uneven(dt) <= UNEVEN


@pytest.mark.parametrize(("steps", "uneven"), [(1, 0), (7, 0), (2.5, 0.2), (9.75, 0.75 / 9.75), (0.3, math.inf)])
def test_whole_numbers_of_steps_are_even(steps, uneven):
    found = Film(steps * 1e-5).uneven(1e-5)
    assert found > 1 if math.isinf(uneven) else found == pytest.approx(uneven, abs=1e-9)


def test_a_film_is_described_and_compared():
    film = Film(0.005, ("x", "v", "q"))
    assert parse_probe(describe_probe(film)) == film
    assert describe_probe(Sample(every=2)) == '{"every":2,"fields":["x","v"],"kind":"sample"}', "as stored in labs"
    assert Film(0.004).as_often(Film(0.005))
    assert Film(0.0054).as_often(Film(0.005))
    assert not Film(0.0115).as_often(Film(0.005))
    for every in ("0.0", "-1.0", "1e999", "NaN"):
        with pytest.raises(ValueError, match="description"):
            parse_probe(describe_probe(film).replace("0.005", every))
