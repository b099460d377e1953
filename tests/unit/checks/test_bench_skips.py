"""What a backend leaves out can be put back, and that changes no bit."""

from dataclasses import replace

import pytest
from labbook_dem.features import ALWAYS, covers

from labbook.backend import load
from labbook.checks.bench import skips
from labbook.checks.bench.skips import SKIPS
from labbook.checks.bench.speed import FAN_STEP, fan


@pytest.mark.compiles
@pytest.mark.ring
def test_what_is_put_back_costs_time_and_changes_no_bit():
    chosen = [skip for skip in SKIPS if skip.name in ("walls that move", "frames of all grains at every beat")]
    result = skips.run("numba", repeats=1, skips=chosen, grains=200)
    assert [one.name for one in result.saved] == [skip.name for skip in chosen]
    assert all(one.same and one.difference == 0 for one in result.saved)
    assert all(0 < one.low <= one.times <= one.high for one in result.saved)
    assert result.as_dict()["backend"] == "numba"
    assert result.fall > 2


@pytest.mark.parametrize("skip", SKIPS, ids=[skip.name for skip in SKIPS])
def test_every_skip_leaves_something_out_that_kernels_with_it_cover(skip):
    numba = load("numba")
    scene = skip.scene(fan(grains=10).close())
    plain = numba.specialise(scene, FAN_STEP, skip.probes)
    whole = skip.spec(numba, scene, FAN_STEP)
    assert covers(whole, plain)
    if skip.features or skip.walls:
        assert not covers(plain, whole)
    else:
        assert skip.numerics or skip.probes or skip.restored(scene) != scene


def test_every_feature_that_may_be_left_out_is_put_back_by_one():
    by_features = {name for skip in SKIPS for name in skip.features} | {"walls"}
    assert set(ALWAYS) - by_features == {"ANY_WALLS"}, "scenes without any wall are no hopper"


def test_clumps_of_one_sphere_have_the_mass_of_the_spheres_that_they_stand_for():
    (skip,) = (skip for skip in SKIPS if "clumps" in skip.name)
    scene = fan(grains=10).close()
    clumps = skip.restored(scene).grains
    assert clumps.shape == "clump"
    assert (clumps.mass, clumps.inertia, clumps.count) == (scene.grains.mass, scene.grains.inertia, 10)


def test_kernels_of_another_law_cover_nothing():
    numba = load("numba")
    spec = numba.specialise(fan(grains=10).close(), FAN_STEP)
    other = replace(spec, features=tuple((k, "linear" if k == "law" else v) for k, v in spec.features))
    assert not covers(other, spec)
    assert not covers(replace(spec, steps_per_beat=1), spec)


def test_a_feature_that_a_backend_does_not_have_is_named():
    numba = load("numba")
    with pytest.raises(ValueError, match="no features WINGS"):
        skips.Skip("wings", features={"WINGS": True}).spec(numba, fan(grains=10).close(), FAN_STEP)
