"""Friction of walls is mobilised before the opening: a bed rests, its upright walls move up, and it rests again."""

import json
from dataclasses import replace

import labbook_toy
import pytest
from toy_lab import arrays, carry_out, labbook, study, study_file

from labbook.backend import Checkpoint
from labbook.filling.mobilising import Mobilise, lifted
from labbook.lab import LabFolder
from labbook.lab.packings import read_packing
from labbook.plan.demand import demands
from labbook.scene import Box, ConicalSilo, CylinderSilo, LinearSpringDashpot, Scene, Spheres, WedgeHopper

MOBILISE = "fill: {mobilise: {bottom: 0.1 d, velocity: 1 mm/s}}"
TIME = 0.3
CONTAINERS = {
    "cylinder": (CylinderSilo(diameter=0.04, height=0.1, orifice=0.012, rotation=2.0), {"side"}),
    "cone": (ConicalSilo(diameter=0.04, height=0.1, orifice=0.012, angle=0.7), {"side"}),
    "hopper": (
        WedgeHopper(width=0.04, height=0.1, thickness=3.03e-3, angle=0.7, orifice=0.012),
        {"front", "back", "left", "right"},
    ),
    "box": (Box(width=0.03, depth=0.03, height=0.1), {"front", "back", "left", "right"}),
}


@pytest.mark.parametrize("name", CONTAINERS)
def test_upright_walls_move_up_and_all_else_stays(name):
    container, upright = CONTAINERS[name]
    law = LinearSpringDashpot(normal_stiffness=1e3, friction=0.5, rolling_friction=0.0, restitution=0.5)
    closed = Scene(grains=Spheres(diameter=3e-3, density=2500, count=100), contact=law, container=container).close()
    moved = lifted(closed, 2e-3)
    before, after = closed.container.walls(), moved.container.walls()
    assert [wall.name for wall in before] == [wall.name for wall in after]
    assert [wall.shape for wall in before] == [wall.shape for wall in after]
    motions = {wall.name: wall.motion.velocity for wall in after}
    assert {wall for wall, velocity in motions.items() if velocity == (0.0, 0.0, 2e-3)} == upright
    assert {velocity for wall, velocity in motions.items() if wall not in upright} <= {(0.0, 0.0, 0.0)}
    assert moved.outlet is None
    assert (moved.grains, moved.contact, moved.walls) == (closed.grains, closed.contact, closed.walls)


def mobilised(folder, *more):
    return study(folder, MOBILISE, *more, orifices="[24]", replicates=1)


def test_it_is_in_the_key_of_the_packing_only_where_it_is_stated(tmp_path):
    backend = labbook_toy.Backend().capabilities
    (plain,) = demands(study(tmp_path, orifices="[24]", replicates=1), 1)
    (stated,) = demands(mobilised(tmp_path), 1)
    assert stated.filling.mobilise == Mobilise(bottom=3e-4, velocity=1e-3)
    assert plain.keys(backend).packing != stated.keys(backend).packing
    assert plain.shared.closed_key == stated.shared.closed_key
    slower = study(tmp_path, MOBILISE.replace("1 mm", "0.5 mm"), orifices="[24]", replicates=1)
    assert len({one.keys(backend).packing for one in (stated, *demands(slower, 1))}) == 2


@pytest.fixture
def admitted(monkeypatch):
    """Scenes and starts of the members that the toy was given, in order."""
    found, admit = [], labbook_toy.Ensemble.admit

    def noted(ensemble, scene, numerics, start, **options):
        found.append((scene, start))
        return admit(ensemble, scene, numerics, start, **options)

    monkeypatch.setattr(labbook_toy.Ensemble, "admit", noted)
    return found


def packing_of(lab):
    (folder,) = (LabFolder(lab).packing("x").parent).iterdir()
    return folder


@pytest.mark.slow
def test_a_bed_rests_moves_and_rests_again(tmp_path, admitted):
    carry_out(study(tmp_path, orifices="[24]", replicates=1), tmp_path / "plain")
    admitted.clear()
    asked = mobilised(tmp_path)
    assert not carry_out(asked, tmp_path / "lab").tally.failed
    closed = next(iter(demands(asked, 1))).shared.closed
    scenes = [scene for scene, _ in admitted]
    assert scenes[:3] == [closed, lifted(closed, 1e-3), closed]
    assert [isinstance(start, Checkpoint) for _, start in admitted] == [False, True, True, False]
    first, _ = read_packing(packing_of(tmp_path / "plain"))
    record, _ = read_packing(packing_of(tmp_path / "lab"))
    assert record.scene == closed
    beat = asked.points[0].numerics.beat
    assert first.duration + TIME < record.duration < first.duration + TIME + 0.1
    assert record.duration - first.duration - TIME >= 3 * beat, "it rests for as many beats again"
    assert "mobilise" not in json.dumps(json.loads((packing_of(tmp_path / "plain") / "packing.json").read_text()))


@pytest.mark.slow
def test_cut_short_in_any_stage_it_has_the_bits_of_one_in_one_go(tmp_path, monkeypatch, admitted):
    asked = mobilised(tmp_path)
    carry_out(asked, tmp_path / "alone")
    total = round(read_packing(packing_of(tmp_path / "alone"))[0].duration / asked.points[0].numerics.beat)
    advance, beats = labbook_toy.Ensemble.advance, 0

    def interrupted(ensemble, count=1):
        nonlocal beats
        beats += 1
        if beats % (total // 5) == 0:
            raise KeyboardInterrupt
        return advance(ensemble, count)

    monkeypatch.setattr(labbook_toy.Ensemble, "advance", interrupted)
    cuts = 0
    while not any(packings := list((tmp_path / "lab" / "packings").glob("*/packing.json"))):
        cuts += 1
        assert cuts < 10
        with pytest.raises(KeyboardInterrupt):
            carry_out(asked, tmp_path / "lab", checkpoint_every=0)
    assert cuts >= 5, packings
    closed = next(iter(demands(asked, 1))).shared.closed
    entered = [scene for scene, start in admitted if isinstance(start, Checkpoint)]
    assert entered.count(lifted(closed, 1e-3)) > 2, "once by its stage, and again after each cut within it"
    assert arrays(packing_of(tmp_path / "lab")) == arrays(packing_of(tmp_path / "alone"))


class OnDevice(labbook_toy.Backend):
    """The toy on a device, whose ensemble has all beds."""

    def __init__(self):
        super().__init__()
        self.capabilities = replace(self.capabilities, devices=("cpu", "cuda:0"))

    def open(self, spec, slots=None, device="cpu"):
        return super().open(spec, None, "cpu")


@pytest.mark.slow
def test_beds_side_by_side_are_those_of_one_after_another(tmp_path, admitted):
    """They share an ensemble, in which each changes its scene when it is at rest."""
    asked = study(tmp_path, MOBILISE, orifices="[24]", replicates=2)
    carry_out(asked, tmp_path / "core")
    admitted.clear()
    carry_out(asked, tmp_path / "device", backend=OnDevice(), device="cuda:0")
    closed = next(iter(demands(asked, 1))).shared.closed
    assert [scene for scene, _ in admitted].count(lifted(closed, 1e-3)) == 2
    for folder in (tmp_path / "core" / "packings").iterdir():
        assert arrays(folder) == arrays(tmp_path / "device" / "packings" / folder.name)


@pytest.mark.parametrize(
    ("fill", "key", "remedy"),
    [
        ("fill: {mobilise: {bottom: 0.1 d, velocity: 0 m/s}}", "fill.mobilise.velocity", "0"),
        ("fill: {mobilise: {bottom: 0.1 d, velocity: 500 m/s}}", "fill.mobilise.velocity", "slow motion"),
        ("fill: {mobilise: {bottom: 0.1 d}}", "fill.mobilise.velocity", "this key is missing"),
    ],
)
def test_motions_that_cannot_be_are_refused(tmp_path, fill, key, remedy):
    output = labbook("plan", study_file(tmp_path, fill), "--lab", tmp_path / "lab", check=False).output
    assert key in output
    assert remedy in " ".join(output.split())


def test_a_container_without_upright_walls_is_refused(tmp_path):
    path = study_file(tmp_path, MOBILISE, orifices="[24]")
    text = path.read_text()
    cone = "{kind: frustum, lower: [0 mm, 0 mm], upper: [60 mm, 60 mm]}"
    start = text.index("container:")
    end = text.index("\n", start)
    primitives = f"container: {{kind: primitives, parts: [{{name: cone, shape: {cone}}}]}}"
    head, _, tail = (text[:start] + primitives + text[end:]).partition("sweep:")
    path.write_text(head + "\n".join(line for line in tail.splitlines()[2:]) + "\n")
    output = labbook("plan", path, "--lab", tmp_path / "lab", check=False).output
    assert "no upright wall" in output, path.read_text()
