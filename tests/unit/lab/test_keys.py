"""Keys tell apart what gives different results, and nothing else."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labbook.backend import Capabilities
from labbook.backend.numerics import Numerics
from labbook.lab import identity
from labbook.lab.identity import Filling
from labbook.scene import HertzMindlin, Primitives, Scene, Spheres, SurfaceChange, WedgeHopper
from labbook.scene.model import canonical, digest


def scene(**changes) -> Scene:
    contact = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, restitution=0.2)
    given = {
        "grains": Spheres(diameter=3e-3, density=2500, count=3000),
        "contact": contact,
        "container": WedgeHopper(width=0.1, height=0.4, thickness=3.03e-3, orifice=0.03),
    }
    return Scene(**{**given, **changes})


def backend(name="numba", version=1) -> Capabilities:
    none: frozenset[str] = frozenset()
    return Capabilities(name, version, none, none, none, none, ("cpu",))


def identities(scene_=None, backend_=None, filling=None, numerics=None) -> identity.Keys:
    one = scene_ or scene()
    return identity.run_keys(
        identity.scene_key(one),
        identity.scene_key(one.close()),
        filling or Filling("rain", 1, 1e-6, 1),
        numerics or Numerics(dt=2.5e-6),
        backend_ or backend(),
    )


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@given(JSON)
def test_the_order_in_which_keys_were_written_does_not_matter(value):
    def turned(item):
        if isinstance(item, dict):
            return {key: turned(item[key]) for key in reversed(list(item))}
        return [turned(one) for one in item] if isinstance(item, list) else item

    assert digest(value) == digest(turned(value))


@given(st.floats(allow_nan=False, allow_infinity=False), st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_count_to_the_last_digit_and_minus_zero_is_zero(a, b):
    assert (digest({"x": a}) == digest({"x": b})) == (a == b)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_has_no_key(bad):
    with pytest.raises(ValueError, match="JSON"):
        digest({"x": [bad]})


def test_canonical_form_is_frozen():
    assert canonical({"b": [1.0, -0.0], "a": {"é": None}}) == '{"a":{"\\u00e9":null},"b":[1.0,0.0]}'
    assert digest({"b": 1}) == "eb8ed3ccb5023093b56f490a"  # printf '{"b":1}' | sha256sum


def test_a_scene_is_known_by_its_walls_not_by_how_it_is_spelled():
    hopper = scene()
    explicit = scene(walls={"left": SurfaceChange(friction=0.5)})
    parts = Primitives(parts=hopper.container.walls(), outlet_plane=0.0)
    assert identity.scene_key(hopper) == identity.scene_key(explicit) == identity.scene_key(scene(container=parts))


@pytest.mark.parametrize(
    "other",
    [
        scene(gravity=9.8),
        scene(grains=Spheres(diameter=3e-3, density=2500, count=3001)),
        scene(walls={"left": SurfaceChange(friction=0.4)}),
        scene(container=WedgeHopper(width=0.1, height=0.4, thickness=3.03e-3, orifice=0.0301)),
        scene(contact=HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, restitution=0.21)),
    ],
)
def test_what_changes_the_motion_changes_the_key(other):
    assert identity.scene_key(other) != identity.scene_key(scene())


def test_flat_bottoms_share_packings_and_inclined_ones_do_not():
    def packing(**change):
        hopper = WedgeHopper(**{"width": 0.1, "height": 0.4, "thickness": 3.03e-3, "orifice": 0.03, **change})
        return identities(scene(container=hopper)).packing

    assert packing() == packing(orifice=0.045) == packing(gap=0.006) == packing(height=0.5)
    assert packing(angle=math.radians(55)) != packing(angle=math.radians(55), orifice=0.045)


def test_guards_are_no_part_of_a_key_but_steps_are():
    plain = identities()
    assert identities(numerics=Numerics(dt=2.5e-6, speed_limit=5.0, overlap_limit=0.1)) == plain
    for change in (
        {"dt": 1e-6},
        {"precision": "mixed"},
        {"skin": 0.2},
        {"steps_per_beat": 500},
        {"stiffness_scale": 0.1},
    ):
        assert identities(numerics=Numerics(**{"dt": 2.5e-6, **change})).run != plain.run


def test_backends_share_an_experiment_only_by_sharing_a_packing():
    one, other = identities(), identities(backend_=backend("warp"))
    assert one.scene == other.scene
    assert one.experiment != other.experiment
    assert one.run != other.run


def test_a_new_version_of_the_backend_is_another_run_of_the_same_lineage():
    old, new = identities(), identities(backend_=backend(version=2))
    assert old.run != new.run
    assert old.packing != new.packing
    assert old.lineage == new.lineage


@pytest.mark.parametrize(
    "change", [{"seed": 2}, {"kind": "gas"}, {"settled_below": 1e-7}, {"placing": 2}, {"moving": 0.01}]
)
def test_the_filling_decides_the_packing(change):
    filling = Filling(**{"kind": "rain", "seed": 1, "settled_below": 1e-6, "placing": 1, **change})
    assert identities(filling=filling).packing != identities().packing
    assert identities(filling=filling).scene == identities().scene


def test_a_filling_in_which_no_grain_may_move_keeps_the_key_it_had_before_there_was_a_choice():
    filling = {"kind": "rain", "seed": 1, "settled_below": 1e-6, "placing": 1}
    numerics, closed = Numerics(dt=2.5e-6), identity.scene_key(scene().close())
    without = {"scene": closed, "filling": filling, "numerics": identity.numerics_identity(numerics), "maker": "numba"}
    expected = digest({**without, "cache_version": backend().cache_version})
    made = Filling(**filling, moving=0.0)
    assert identity.packing_key(closed, made, numerics, backend().name, backend().cache_version) == expected


def test_a_packings_maker_decides_the_experiment_and_not_who_goes_on_from_it():
    numba, warp = backend(), backend("warp")
    one = scene()
    given = (identity.scene_key(one), identity.scene_key(one.close()), Filling("rain", 1, 1e-6, 1), Numerics(dt=2.5e-6))
    maker = identity.Maker(numba, given[-1])
    own, guest, alone = (
        identity.run_keys(*given, numba),
        identity.run_keys(*given, warp, maker),
        identity.run_keys(*given, warp),
    )
    assert identity.run_keys(*given, numba, maker) == own
    assert (guest.packing, guest.experiment) == (own.packing, own.experiment)
    assert alone.experiment != own.experiment
    assert len({own.run, guest.run, alone.run}) == 3
    assert len({own.lineage, guest.lineage, alone.lineage}) == 3
    assert identity.lineage_key(*given, "warp", maker) == guest.lineage
