"""A calibration of runs of the backend numba by themselves."""

import pytest
from learning import twins

pytest.importorskip("sklearn")
pytest.importorskip("numba")


@pytest.mark.ring
@pytest.mark.compiles
def test_a_twin_finds_its_friction(tmp_path):
    """A5, of one twin: the friction lies in its 95 % interval, and so does W at the outlet that is held out."""
    figures = twins(1, str(tmp_path / "lab"), batch=32)
    assert figures["inside"] == 1
    assert figures["predicted"] == 1
