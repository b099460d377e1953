"""The benchmark of fields measures what it says."""

import coarse_graining


def test_every_grid_is_timed():
    result = coarse_graining.run(grains=200, frames=2, contacts=50)
    assert [one["grid"] for one in result["timings"]] == list(coarse_graining.GRIDS)
    assert all(one["wall"] > 0 and one["contacts_wall"] > 0 for one in result["timings"])
    assert result["threads"] >= 1
