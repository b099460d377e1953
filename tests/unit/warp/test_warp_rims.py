"""The edge of a plate that two neighbouring threads of the GPU backend share, in plain Python: one finds each part."""

import threading
from typing import Any

import numpy as np
import pytest

pytest.importorskip("warp")

from labbook_dem.walls.frustum import frustum_edges
from labbook_dem.words import vec3
from labbook_warp.kernels import rod_walls

pytestmark = pytest.mark.compiles

RIM, HALF, RADIUS = vec3(0.03, 0.0, 0.0), 7e-3, 3e-3
PLATES = {"flat": vec3(1.0, 0.0, 0.0), "cone": vec3(0.6, 0.0, 0.8)}


class TwoThreads:
    """Two threads side by side: each is given what the other has, as both ask."""

    def __init__(self):
        self._met = threading.Barrier(2, timeout=10)
        self._held = {}

    def __call__(self, v):
        me = threading.current_thread().name
        self._held[me] = v
        self._met.wait()
        other = next(value for name, value in self._held.items() if name != me)
        self._met.wait()
        return other

    def run(self, work):
        found = {}
        threads = [
            threading.Thread(target=lambda k=k: found.__setitem__(k, work(k == 1)), name=str(k)) for k in range(2)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return found[0], found[1]


@pytest.mark.parametrize("along", PLATES.values(), ids=PLATES)
def test_two_threads_find_the_edges_that_one_finds(along, monkeypatch):
    """To the last bit; none, one or two of them, and far from the edge too."""
    rim_of_two: Any = rod_walls.rim_of_two
    rng, parts = np.random.default_rng(5), np.zeros(3, int)
    for _ in range(400):
        turn, out = rng.uniform(0, 2 * np.pi), RIM.x + rng.uniform(-8e-3, 4e-3)
        x = vec3(out * np.cos(turn), out * np.sin(turn), rng.uniform(-5e-3, 4e-3))
        a = vec3(*(v := rng.normal(size=3) * (1, 1, 0.3)) / np.linalg.norm(v))
        place = RIM, along, 0.06, x, a, HALF, RADIUS
        met, on, other, back = frustum_edges(*place)
        threads = TwoThreads()
        monkeypatch.setattr(rod_walls, "other_of_two", threads)
        first, second = threads.run(lambda is_second, place=place: rim_of_two(*place, is_second))
        assert (first[0], second[0]) == (met, other)
        if met < 1e9:
            assert first[1] == on
        if other < 1e9:
            assert second[1] == back
        parts[(met < 1e9) + (other < 1e9)] += 1
    assert (parts > 10).all(), parts
