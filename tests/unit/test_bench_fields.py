"""The benchmark of fields measures what it says."""

from labbook.bench import fields


def test_every_grid_is_timed():
    result = fields.run(grains=200, frames=2, contacts=50)
    assert [one.grid for one in result.timings] == list(fields.GRIDS)
    assert all(one.wall > 0 and one.contacts_wall > 0 for one in result.timings)
    assert result.as_dict()["threads"] == result.threads >= 1
