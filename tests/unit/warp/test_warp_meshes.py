"""Walls of triangles on the GPU backend: what they cost scenes without one, checkpoints, threads that share a grain."""

import numpy as np
import pytest
from platforms import identical

pytest.importorskip("warp")

import warp as wp
from labbook_warp import Backend, room
from labbook_warp.build import module_text

from labbook.backend import Checkpoint
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Ledger, Sample, Traction
from labbook.checks.verify.materials import D, G, linear
from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.checks.verify.platform import grains_at
from labbook.scene import Box, Primitives, Scene, Spheres

R = D / 2
PROBES = (Sample(fields=("x", "v", "omega")), Contacts(every=1), Ledger(every=10), Traction(size=1.0))
"""As in the contract, whose kernels the checkpoint here shares."""


def bowl(grains=None) -> Scene:
    """Grains over a sheet of triangles that rises to its sides."""
    vertices, triangles = sheet(6, 8 * R)
    level = np.zeros(len(vertices))
    bent = of_triangles(vertices + np.column_stack([level, level, 0.1 * np.abs(vertices).sum(axis=1)]), triangles)
    box = Box(width=16 * R, depth=16 * R, height=40 * R)
    sides = [wall for wall in box.walls() if wall.name != "bottom"]
    grains = grains or Spheres(diameter=D, density=2500, count=25)
    law = linear(friction=0.4, restitution=0.1)
    return Scene(grains=grains, contact=law, container=Primitives(parts=(*sides, bent)), gravity=G)


def how(precision: str) -> Numerics:
    return Numerics.model_validate({"dt": 2.5e-6, "precision": precision, "steps_per_beat": 50})


def fallen(scene: Scene, numerics: Numerics, device: str, beats: int, lanes: int | None = None):
    """Packing and checkpoint of grains that fell onto the sheet."""
    rng = np.random.default_rng(4)
    place = 2.6 * R * (np.stack(np.meshgrid(range(5), range(5)), axis=-1).reshape(-1, 2) - 2)
    height = R + 0.11 * np.abs(place).sum(axis=1) + 0.01 * R
    start = grains_at(np.column_stack([place, height]), rng.uniform(-0.1, 0.1, (25, 3)) - [0, 0, 0.1])
    backend = Backend(lanes=lanes)
    ensemble = backend.open(backend.specialise(scene, numerics, PROBES), None, device)
    try:
        member = ensemble.admit(scene, numerics, start)
        assert not ensemble.advance(beats)
        return ensemble.packing(member), ensemble.checkpoint(member)
    finally:
        ensemble.close()


@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_kernels_of_scenes_without_a_mesh_know_nothing_of_meshes(precision):
    """No array, no function and no branch; but the switch, and the word in comments."""
    planes = bowl().model_copy(update={"container": Box(width=16 * R, depth=16 * R, height=40 * R)})
    for lanes in (1, 4):
        text = module_text(Backend().specialise(planes, how(precision), PROBES), True, lanes, 0, 0, 0)
        assert [line for line in text.splitlines() if "mesh" in line.lower() and not line.startswith("#")] == [
            "MESHES = False"
        ]


@pytest.mark.compiles
@pytest.mark.slow
def test_springs_of_features_that_a_mesh_lacks_are_refused():
    scene, numerics = bowl(), how("mixed")
    packing, checkpoint = fallen(scene, numerics, "cpu", 80)
    assert len(packing.wall_part) > 10
    backend = Backend()
    backend.verify(scene, numerics, checkpoint, 80 * 50)
    for feature in (-1, 10**6):
        damaged = np.full_like(checkpoint.arrays["wall_feature"], feature)
        arrays = {**checkpoint.arrays, "wall_feature": damaged}
        with pytest.raises(ValueError, match="not of its features"):
            backend.verify(scene, numerics, Checkpoint(checkpoint.backend, checkpoint.cache_version, arrays), 80 * 50)


@pytest.mark.gpu
@pytest.mark.compiles
@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_threads_that_share_a_grain_decide_no_bit(precision, monkeypatch):
    """On a GPU, where one thread a grain leaves walls to a kernel of their own, and several meet them in the step."""
    if not wp.get_cuda_device_count():
        pytest.skip("there is no CUDA device")
    ends = [fallen(bowl(), how(precision), "cuda:0", 80, lanes)[0] for lanes in (1, 2, 4, 8)]
    monkeypatch.setattr(room, "CACHE", 0)
    ends.append(fallen(bowl(), how(precision), "cuda:0", 80, 1)[0])
    assert len(ends[0].wall_part) > 10
    assert all(identical(end, ends[0]) for end in ends[1:])
