"""Packings with rolling springs: stored, opened, mirrored, renumbered; those without stay as they always were."""

from dataclasses import replace

# packings of these tests have rolling springs, unless they say otherwise
# pyright: reportArgumentType=false, reportOptionalMemberAccess=false, reportOptionalOperand=false
import numpy as np
import pytest

from labbook.checks.verify.materials import D, G, linear, scene
from labbook.filling.opening import start_of_discharge
from labbook.lab.tables import write_table
from labbook.scene import WedgeHopper
from labbook.scene.packing import Packing

ROLLING = ("pair_rolling", "wall_rolling")


def two(**given) -> Packing:
    """Two grains that touch each other, the left wall and the bottom."""
    vectors = {name: np.arange(6.0).reshape(2, 3) + k for k, name in enumerate(("x", "v", "omega"))}
    of_walls = {"wall_grain": np.array([0, 1]), "wall_name": np.array(["left", "bottom"])}
    of_pairs = {"pairs": np.array([[0, 1]]), "pair_spring": np.array([[1.0, 2.0, 3.0]])}
    springs = {"wall_spring": np.ones((2, 3)), "pair_rolling": np.array([[4.0, 5.0, 6.0]])}
    rolling = {"wall_rolling": np.array([[7.0, 8.0, 9.0], [1.0, 2.0, 3.0]])}
    return Packing(**{**vectors, **of_walls, **of_pairs, **springs, **rolling, **given})


def without() -> Packing:
    return two(**dict.fromkeys(ROLLING))


def test_they_are_stored_where_there_are_any(tmp_path):
    assert set(two().arrays()) - set(without().arrays()) == set(ROLLING)
    for packing in (two(), without()):
        write_table(tmp_path / "packing.npz", packing.arrays())
        with np.load(tmp_path / "packing.npz") as stored:
            again = Packing(**stored)
        for name, array in packing.arrays().items():
            assert np.array_equal(getattr(again, name), array), name
    assert again.pair_rolling is None
    assert [array.tolist() for array in again.rolling] == [[[0.0] * 3], [[0.0] * 3] * 2]


def test_torques_turn_in_the_mirror_as_spins_do():
    packing, image = two(), two().mirrored()
    for name in ROLLING:
        assert np.array_equal(getattr(image, name), getattr(packing, name) * [1, -1, -1]), name
    assert without().mirrored().wall_rolling is None


def test_the_torque_on_the_other_grain_of_a_pair_is_the_opposite():
    packing, other = two(), two().renumbered(np.array([1, 0]))
    assert other.pairs.tolist() == [[0, 1]]
    assert np.array_equal(other.pair_rolling, -packing.pair_rolling)
    assert np.array_equal(other.wall_rolling, packing.wall_rolling)
    assert other.wall_grain.tolist() == [1, 0]
    assert without().renumbered(np.array([1, 0])).pair_rolling is None


def test_the_wall_that_is_opened_loses_them():
    silo = WedgeHopper(width=20 * D, height=60 * D, thickness=1.01 * D, orifice=8 * D)
    hopper = scene(2, linear(), silo, G)
    packing = two(x=np.array([[-9.5 * D, 0.0, D / 2], [0.0, 0.0, D / 2]]))
    start = start_of_discharge(packing, hopper.close(), hopper)
    assert start.wall_name.tolist() == ["left"]
    assert start.wall_rolling.tolist() == [[7.0, 8.0, 9.0]]
    assert np.array_equal(start.pair_rolling, packing.pair_rolling)
    assert start_of_discharge(replace(packing, wall_rolling=None), hopper.close(), hopper).wall_rolling is None


@pytest.mark.parametrize("name", ROLLING)
def test_what_fits_no_contact_is_refused(name):
    for wrong, told in ((np.zeros((5, 3)), "has shape"), (np.full((2, 3), np.nan), "has shape|is not finite")):
        with pytest.raises(ValueError, match=f"packing: {name} ({told})"):
            two(**{name: wrong})
    fits = getattr(two(), name)
    with pytest.raises(ValueError, match=f"packing: {name} is not finite in row 0"):
        two(**{name: fits * np.nan})
    with pytest.raises(ValueError, match=f"packing: {name} holds int64"):
        two(**{name: fits.astype(np.int64)})
