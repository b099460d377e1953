"""The source of an extension's law or wall: a hash in the keys of what it makes, so that an edit makes runs stale."""

import sys
from importlib import import_module, invalidate_caches

import pytest
from labbook_toy import Backend
from toy_lab import carry_out, study

from labbook.lab import Catalogue, LabFolder, formulas, identity
from labbook.lab.runs import open_run
from labbook.plan.plan import Planner
from labbook.plugins import Extension
from labbook.results.find import find
from labbook.scene import CONTACT_LAWS, HertzMindlin, Scene, Spheres, WedgeHopper
from labbook.scene.walls import WALL_SHAPES

LAW = '''"""A law."""

from typing import ClassVar, Literal

from labbook.scene.contact import LinearSpringDashpot

from .helper import half  # used below


class Viscous(LinearSpringDashpot):
    """A spring."""

    physics: ClassVar[str] = "source_extras.forces"
    law: Literal["viscous"] = "viscous"

    def damping_ratio(self, restitution: float) -> float:
        """Half of it."""
        return half(restitution)
'''
FORCES = '''"""Forces."""


def respond(c, rs, ms, delta, vn, s, vt):
    """N."""
    # a spring
    return c[0] * delta, vt * 0.0, s
'''
HELPER = "def half(x):\n    return x / 2\n"


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Writes a file of a package, and gives the hash of its law, as a new process would."""
    folder = tmp_path / "source_extras"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(**files: str) -> str:
        for name, text in files.items():
            (folder / f"{name}.py").write_text(text, encoding="utf-8")
        for name in [name for name in sys.modules if name.partition(".")[0] == "source_extras"]:
            monkeypatch.delitem(sys.modules, name)
        invalidate_caches()
        return formulas.source_hash(import_module("source_extras.law").Viscous)

    write(__init__="", law=LAW, forces=FORCES, helper=HELPER, apart="x = 1\n")
    return write


def test_an_edit_of_what_is_computed_changes_the_hash_and_one_of_comments_does_not(package):
    before = package()
    unimportant = (
        {"forces": FORCES.replace("# a spring", "# two springs").replace('"""N."""', '"""Forces [N]."""')},
        {"law": LAW.replace("A spring.", "A softer spring.").replace("  # used below", "")},
        {"helper": "# half of x\n\n\n" + HELPER},
        {"apart": "x = 2\n"},
    )
    for files in unimportant:
        assert package(**files) == before, "comments, docstrings and modules that it does not import"
    edits = (
        {"forces": FORCES.replace("c[0] * delta", "c[0] * delta / 2")},
        {"law": LAW.replace("half(restitution)", "restitution")},
        {"helper": HELPER.replace("/ 2", "/ 3")},
    )
    assert len({before, *(package(**files) for files in edits)}) == 4


def scene():
    law = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, restitution=0.2)
    hopper = WedgeHopper(width=0.1, height=0.4, thickness=3.1e-3, orifice=0.03, angle=1.0)
    return Scene(grains=Spheres(diameter=3e-3, density=2500, count=10), contact=law, container=hopper)


@pytest.fixture
def edited(monkeypatch):
    """Make hertz-mindlin a law, and planes walls, of the package bed-extras; sets the hash of both sources."""
    for registry, name in ((CONTACT_LAWS, "hertz-mindlin"), (WALL_SHAPES, "plane")):
        extension = Extension("labbook.contact_laws", name, "bed-extras", "0.1", "bed_extras")
        monkeypatch.setitem(registry.extensions, name, extension)
    return lambda law, wall="a" * 24: monkeypatch.setattr(
        identity, "source_hash", lambda kind: law if kind is HertzMindlin else wall
    )


def test_the_hash_is_part_of_keys_of_scenes_and_not_of_lineages(edited):
    own = identity.scene_key(scene(), {"law hertz-mindlin": 2})
    edited("b" * 24)
    installed = identity.versions(scene())
    assert installed == {
        "law hertz-mindlin": 2, "source of law hertz-mindlin": "b" * 24, "source of wall plane": "a" * 24,
    }  # fmt: skip
    key = identity.scene_key(scene())
    assert key == identity.scene_key(scene(), installed) != own
    assert identity.lineage_scene(scene(), installed, key) == own
    edited("b" * 24, "c" * 24)
    assert len({own, key, identity.scene_key(scene())}) == 3
    assert identity.outdated(installed, identity.versions(scene())) == "the wall plane of bed-extras has changed since"
    assert "before labbook recorded the source of the wall plane" in identity.outdated({}, identity.versions(scene()))


def plan(toy, lab):
    return Planner(toy, Catalogue(lab), Backend().capabilities).plan()


def test_runs_by_another_source_are_stale_and_enter_no_mean_of_newer_ones(tmp_path, edited):
    lab, toy = tmp_path / "lab", study(tmp_path, replicates=2)
    edited("b" * 24)
    carry_out(toy, lab)
    assert plan(toy, lab).counts() == {"done": 4}
    for folder in LabFolder(lab).runs.iterdir():
        record, _ = open_run(folder)
        assert record.versions["source of law hertz-mindlin"] == "b" * 24
    why = "the law hertz-mindlin of bed-extras has changed since"
    edited("c" * 24)
    assert {(item.state, item.reason) for item in plan(toy, lab).items} == {("stale", why)}
    assert find(toy, Catalogue(lab), "toy").stale == {why: 4}
    carry_out(study(tmp_path, replicates=1), lab)
    mixed = find(toy, Catalogue(lab), "toy")
    assert not mixed.stale
    assert {len(point.runs) for point in mixed.points} == {1}
    edited("b" * 24)
    assert plan(toy, lab).counts() == {"done": 4}, "an edit that is taken back costs nothing"
    edited("d" * 24)
    results = find(toy, Catalogue(lab), "toy")
    assert {len(point.runs) for point in results.points} == {1}, "of two sources the newer one is shown"
    for folder in LabFolder(lab).runs.iterdir():
        open_run(folder)
