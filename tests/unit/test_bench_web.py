"""`benchmarks/web.py pages`, on a small lab."""

import pytest

import web


@pytest.mark.slow
def test_every_page_of_a_made_up_lab_is_timed(tmp_path):
    found = web.pages(tmp_path / "lab", 250, 1, side=5)
    assert [one["page"] for one in found] == list(web.PAGES)
    assert all(one["first"] > 0 and one["later"] > 0 and one["kilobytes"] > 0 for one in found)
