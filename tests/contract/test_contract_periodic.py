"""Periodic sides: contacts across them for few and for many cells along y, and the same bits from a checkpoint."""

from collections.abc import Sequence

import numpy as np
import pytest
from platforms import Bundled, identical
from scipy.spatial import KDTree

from labbook.backend import Checkpoint
from labbook.backend.probes import Contacts, Ledger
from labbook.checks.verify.materials import D, G, hertz, scene, spheres
from labbook.checks.verify.periodic import DT, SOFT
from labbook.filling.placing import place
from labbook.scene import Box, Scene
from labbook.scene.packing import Packing
from labbook.scene.periodic import nearest_images

CLOSE = 0.97
"""Size of the grains when they are placed: with their own they overlap somewhat."""
PERIODS = (2.01, 2.6, 3.7, 5.9, 9.0, 14.0)
"""In diameters: one cell along y, two, three and more."""
CONTACTS = Contacts(every=1)


def crowd(period: float) -> tuple[Scene, Packing]:
    """Grains of a dense start, some of which overlap a little."""
    count = round(40 * period)
    of = scene(count, hertz(shear_modulus=SOFT), Box(width=6 * D, depth=period * D, height=40 * D, periodic="y"), G)
    smaller = of.model_copy(update={"grains": spheres(count).model_copy(update={"diameter": CLOSE * D})})
    return of, place(smaller, "dense", 1)


def ends(platform: Bundled, of: Scene, start: Packing | Checkpoint, beats: int, steps: int):
    """Packing, checkpoint and last contacts of a member."""
    numerics = platform.numerics(DT, steps_per_beat=steps)
    ensemble = platform.backend.open(
        platform.backend.specialise(of, numerics, (CONTACTS, Ledger())), 1, platform.device
    )
    try:
        member = ensemble.admit(of, numerics, start)
        assert not ensemble.advance(beats)
        rows = ensemble.drain()[CONTACTS]
        last = rows["step"] == rows["step"].max()
        table = {name: column[last] for name, column in rows.items()}
        return ensemble.packing(member), ensemble.checkpoint(member), table
    finally:
        ensemble.close()


def touching(packing: Packing, period: float) -> dict[tuple[int, int], np.ndarray]:
    """Branches of touching pairs by ids, among grains and two images of each."""
    n, ids = len(packing), ids_of(packing)
    every = np.concatenate([packing.x + np.array([0, k * period, 0]) for k in (0, -1, 1)])
    pairs = KDTree(every).query_pairs(D, output_type="ndarray")
    pairs = pairs[(pairs < n).any(axis=1)]
    first, second = np.where(pairs[:, :1] < n, pairs, pairs[:, ::-1]).T
    i, j = ids[first % n], ids[second % n]
    branch = every[second] - every[first]
    return {
        (min(a, b), max(a, b)): b_ij if a < b else -b_ij
        for a, b, b_ij in zip(i.tolist(), j.tolist(), branch, strict=True)
    }


def ids_of(packing: Packing) -> np.ndarray:
    assert packing.ids is not None
    return packing.ids


def across(branches: Sequence[np.ndarray], packing: Packing, pairs: Sequence[tuple[int, int]]) -> int:
    """Number of contacts across the sides."""
    x = packing.x[np.argsort(ids_of(packing))]
    return sum(abs(x[j, 1] - x[i, 1] - b[1]) > D for (i, j), b in zip(pairs, branches, strict=True))


@pytest.mark.parametrize("period", PERIODS)
def test_every_contact_is_there_once(platform: Bundled, period):
    of, start = crowd(period)
    packing, _, rows = ends(platform, of, start, 1, 1)
    expected = touching(packing, of.container.period)
    between = rows["j"] >= 0
    i, j = rows["i"][between], rows["j"][between]
    pairs = list(zip(np.minimum(i, j).tolist(), np.maximum(i, j).tolist(), strict=True))
    assert sorted(pairs) == sorted(expected)
    assert across([expected[pair] for pair in pairs], packing, pairs) > 3
    sense = np.where(i < j, 1.0, -1.0)[:, None]
    branch = sense * np.column_stack([rows[name][between] for name in ("bx", "by", "bz")])
    assert np.abs(branch - [expected[pair] for pair in pairs]).max() < 1e-6 * D, "rows of contacts may be single"


def test_members_of_other_periods_side_by_side_change_no_bit(platform: Bundled):
    crowds = [crowd(period) for period in (2.6, 5.9)]
    numerics = platform.numerics(DT, steps_per_beat=60)
    ensemble = platform.backend.open(
        platform.backend.specialise(crowds[0][0], numerics, (CONTACTS, Ledger())), 2, platform.device
    )
    try:
        members = [ensemble.admit(of, numerics, start) for of, start in crowds]
        assert not ensemble.advance(1)
        for member, (of, start) in zip(members, crowds, strict=True):
            assert identical(ensemble.packing(member), ends(platform, of, start, 1, 60)[0])
    finally:
        ensemble.close()


def test_on_from_a_checkpoint_with_the_same_bits(platform: Bundled):
    of, start = crowd(3.7)
    along = np.array([0.0, 1.0, 0.0])
    start = Packing(x=start.x + 40.0 * along, v=start.v + 2.0 * along, omega=start.omega)
    whole, _, _ = ends(platform, of, start, 2, 60)
    _, half, _ = ends(platform, of, start, 1, 60)
    again, _, _ = ends(platform, of, half, 1, 60)
    assert identical(whole, again)
    assert np.abs(whole.x[:, 1]).max() <= of.container.period / 2, "places outside are brought into the box"
    order = np.argsort(ids_of(whole))
    moved = nearest_images(whole.x[order] - start.x, of.container.period)
    assert np.abs(moved[:, 1]).min() > D
