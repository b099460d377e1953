"""A checkpoint is exact: it changes nothing when taken, and continues bit for bit when restored."""

from dataclasses import replace

import numpy as np
import pytest
from platforms import identical

from labbook.checks.verify.platform import rows_of
from labbook.filling import lifted

BEATS = 12


@pytest.fixture(scope="module")
def uninterrupted(silo):
    return silo.discharge(BEATS)


@pytest.mark.parametrize("at", [0, 1, 5, 11])
def test_restored_it_continues_bit_for_bit(silo, uninterrupted, at):
    """Also across rebuilds and with grains leaving, which go on before and after most of these beats."""
    state, tables = uninterrupted
    with silo.ensemble() as first:
        member = silo.admit(first)
        if at:
            first.advance(at)
        before = first.drain()
        checkpoint = first.checkpoint(member)
        status = first.status(member)
    with silo.ensemble(slots=1) as second:
        restored = silo.admit(second, checkpoint)
        assert second.status(restored) == status
        second.advance(BEATS - at)
        after = second.drain()
        assert identical(second.packing(restored), state)
        for probe, table in tables.items():
            parts = [rows_of(r[probe], m) for r, m in ((before, member), (after, restored)) if probe in r]
            joined = {name: np.concatenate([part[name] for part in parts]) for name in table}
            assert identical(joined, table), probe


def test_taking_it_or_a_packing_changes_nothing(silo, uninterrupted):
    state, tables = uninterrupted
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        for _ in range(BEATS):
            ensemble.checkpoint(member)
            ensemble.packing(member)
            ensemble.status(member)
            ensemble.advance(1)
        assert identical(ensemble.packing(member), state)
        rows = ensemble.drain()
        for probe, table in tables.items():
            assert identical(rows_of(rows[probe], member), table)


def test_it_goes_on_in_a_scene_whose_walls_move_otherwise(silo):
    """The motion of surfaces is no part of the state: it may begin and end (`fill.mobilise`). Velocities at the whole
    step are predicted by forces, which know it."""
    moving, ends = lifted(silo.scene, 0.05), []
    with silo.ensemble(scene=moving) as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(3)
        checkpoint, before = ensemble.checkpoint(member), ensemble.packing(member)
        ensemble.retire(member)
        for scene in (silo.scene, moving):
            member = ensemble.admit(scene, silo.numerics(), checkpoint)
            assert np.array_equal(ensemble.packing(member).x, before.x)
            assert np.array_equal(ensemble.packing(member).wall_spring, before.wall_spring)
            ensemble.advance(3)
            ends.append(ensemble.packing(member))
            ensemble.retire(member)
    with silo.ensemble() as alone:
        member = silo.admit(alone, checkpoint)
        alone.advance(3)
        assert identical(alone.packing(member), ends[0]), "as by kernels for walls at rest"
    assert not identical(*ends)


def test_it_does_not_follow_the_member(silo):
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(3)
        checkpoint = ensemble.checkpoint(member)
        kept = {name: array.copy() for name, array in checkpoint.arrays.items()}
        ensemble.advance(3)
        assert identical(checkpoint.arrays, kept)
        again = silo.admit(ensemble, checkpoint)
        ensemble.advance(1)
        assert identical(checkpoint.arrays, kept)
        assert ensemble.status(again).step == 4 * silo.numerics().steps_per_beat


def test_it_may_be_restored_twice(silo):
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(3)
        checkpoint = ensemble.checkpoint(member)
        twins = [silo.admit(ensemble, checkpoint) for _ in range(2)]
        ensemble.advance(3)
        states = [ensemble.packing(m) for m in (member, *twins)]
        assert identical(states[0], states[1])
        assert identical(states[0], states[2])


@pytest.mark.parametrize("change", [{"backend": "another"}, {"cache_version": -1}])
def test_of_another_backend_or_version_it_is_refused(silo, change):
    with silo.ensemble() as ensemble:
        checkpoint = ensemble.checkpoint(silo.admit(ensemble))
        with pytest.raises(ValueError, match="checkpoint"):
            silo.admit(ensemble, replace(checkpoint, **change))


def _whole(array):
    return np.issubdtype(array.dtype, np.integer)


DAMAGES = {
    "missing": lambda array: None,
    "shorter": lambda array: array[:-1] if array.ndim else array[None],
    "another shape": lambda array: array[..., None],
    "another type": lambda array: array.astype(np.complex128),
    "not finite": lambda array: None if _whole(array) else np.full_like(array, np.nan),
    "out of range": lambda array: np.full_like(array, np.iinfo(array.dtype).max) if _whole(array) else None,
    "negative": lambda array: array * 0 - 1 if np.issubdtype(array.dtype, np.signedinteger) else None,
}
UNREAD = {"cross", "rebuilds", "gone"}
"""Arrays of which no number is an index, or decides anything but which crossings are told."""


@pytest.mark.parametrize("kind", DAMAGES)
def test_a_damaged_one_is_refused_before_anything_runs(silo, kind):
    """With indices out of range the process would end; with a position that is no number, other grains would not."""
    with silo.ensemble() as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(3)
        sound = ensemble.checkpoint(member)
        backend, step = silo.platform.backend, ensemble.status(member).step
        backend.verify(silo.scene, silo.numerics(), sound, step)
        with pytest.raises(ValueError, match="step"):
            backend.verify(silo.scene, silo.numerics(), sound, step + 1)
        taken, older = [], silo.platform.older(sound.arrays)
        for name, array in sound.arrays.items():
            changed = DAMAGES[kind](array)
            unread = name in UNREAD and kind in ("not finite", "out of range", "negative")
            lacking = kind == "missing" and name not in older
            if not array.size or unread or lacking or (changed is None and kind != "missing"):
                continue
            rest = {other: kept for other, kept in sound.arrays.items() if other != name}
            damaged = replace(sound, arrays=rest if changed is None else rest | {name: changed})
            for how, look in (
                ("admit", lambda: silo.admit(ensemble, damaged)),  # noqa: B023 -- called at once
                ("verify", lambda: backend.verify(silo.scene, silo.numerics(), damaged, step)),  # noqa: B023
            ):
                try:
                    look()
                except ValueError:
                    continue
                taken.append((name, how))
        assert not taken


def test_it_is_made_of_plain_arrays(silo):
    with silo.ensemble() as ensemble:
        checkpoint = ensemble.checkpoint(silo.admit(ensemble))
    assert checkpoint.backend == silo.platform.backend.capabilities.name
    assert checkpoint.cache_version == silo.platform.backend.capabilities.cache_version
    assert all(isinstance(a, np.ndarray) and a.dtype != object for a in checkpoint.arrays.values())
