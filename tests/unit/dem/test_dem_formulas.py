"""What a law, a wall or a shape must define, and the message where it does not."""

from types import ModuleType
from typing import ClassVar

import pytest
from labbook_dem import dispatch, formulas, laws, walls
from labbook_dem.laws import REQUIRED, hertz_mindlin
from labbook_dem.source import undefined_names
from labbook_dem.walls import plane

from labbook.plugins import BrokenPlugin
from labbook.scene.contact import CONTACT_LAWS
from labbook.scene.walls import WALL_SHAPES


class Law:
    physics: ClassVar[str] = "nowhere.to_be_found"


def known(required) -> formulas.Formulas:
    return formulas.Formulas("contact law", laws.__name__, {"mine": Law}, lambda _name: required)


def test_a_law_whose_module_is_not_there_is_named():
    with pytest.raises(BrokenPlugin, match=r"the contact law mine: .*nowhere"):
        known(REQUIRED)["mine"]


def test_a_law_without_a_module_is_asked_for_it(monkeypatch):
    monkeypatch.delattr(Law, "physics")
    with pytest.raises(BrokenPlugin, match=r"the contact law mine has no formulas: state .*\.Law\.physics"):
        known(REQUIRED)["mine"]


def test_every_law_and_wall_of_labbook_has_its_formulas_under_its_name():
    types, modules = {**CONTACT_LAWS, **WALL_SHAPES}, {**laws.LAWS, **walls.WALLS}
    own = {name for name in types if not hasattr(types[name], "physics")} - {
        walls.MESH
    }  # whose are in labbook_dem.mesh
    assert {"hertz-mindlin", "linear", "plane", "frustum"} <= own
    assert {modules[name].__name__.rpartition(".")[2] for name in own} == {formulas.identifier(name) for name in own}


def test_what_a_law_lacks_is_named_with_the_place(monkeypatch):
    monkeypatch.setattr(Law, "physics", hertz_mindlin.__name__)
    assert known(REQUIRED)["mine"] is hertz_mindlin
    with pytest.raises(BrokenPlugin, match=r"the contact law mine: labbook_dem.laws.hertz_mindlin lacks adhesion"):
        known((*REQUIRED, "adhesion"))["mine"]


TYPO = """
from labbook_dem.contact import cut
from labbook_dem.words import coefs, func, real, vec3


def coefficients(law, surface, stiffness_scale=1.0, wall=False):
    return later(law)


@func
def respond(c: coefs, rs: real, ms: real, delta: real, vn: real, s: vec3, vt: vec3):
    force = max(delta, real(0.0))
    return force, curt(vt, force), s


@func
def normal(c: coefs, rs: real, ms: real, delta: real, vn: real):
    return delta
"""


def test_a_name_that_formulas_use_and_nothing_defines_is_told_with_its_line(monkeypatch, tmp_path):
    """Compilers tell it in some hundred lines, of which none names the law."""
    (tmp_path / "law_with_a_typo.py").write_text(TYPO, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(Law, "physics", "law_with_a_typo")
    with pytest.raises(BrokenPlugin) as raised:
        known(REQUIRED)["mine"]
    assert str(raised.value) == "the contact law mine: law_with_a_typo, line 13: curt is not defined"


def test_all_names_that_formulas_of_labbook_use_are_defined():
    for module in (*laws.LAWS.values(), *walls.WALLS.values()):
        assert undefined_names(module) == []


WALL = """
from labbook_dem.words import func, section, wide, wide3

PARTS = 2


def parameters(shape):
    return {numbers}


@func
def mine_distance({first}, x: wide3):
    return wide(0.0), x


@func
def mine_rod({rod}, x: wide3, a: wide3, half: wide, part: int):
    return wide(0.0), x, half
"""


@pytest.fixture
def wall(tmp_path, monkeypatch):
    """A wall called `mine`, whose module is made of WALL."""

    def made(first: str, numbers: str, rod: str = "") -> str:
        module = ModuleType("mine")
        module.__file__ = str(tmp_path / f"mine{len(list(tmp_path.iterdir()))}.py")
        (tmp_path / module.__file__).write_text(text := WALL.format(first=first, numbers=numbers, rod=rod or first))
        exec(compile(text, module.__file__, "exec"), vars(module))
        monkeypatch.setattr(dispatch, "WALLS", {"plane": plane, "mine": module})
        monkeypatch.setattr(walls, "WALLS", {"plane": plane, "mine": module})
        return dispatch.functions(("plane", "mine"), rods=True, at="walls[w, {k}]")

    return made


class Mine:
    kind = "mine"


def test_numbers_are_taken_up_in_the_order_of_the_annotations(wall):
    text = wall("centre: wide3, width: wide, way: section", "(0.0,) * 6")
    assert dispatch.how_many("mine") == 6
    assert len(dispatch.numbers(Mine())) == 6  # pyright: ignore[reportArgumentType]
    assert "width = walls[w, 3]" in text
    assert "way = wide3(walls[w, 4], wide(0.0), walls[w, 5])" in text
    assert "if kind == 1:\n        centre = " in text
    assert text.count("return mine_rod(centre, width, way, x, a, half, part)") == 1


def test_a_wall_whose_numbers_do_not_fit_its_functions_is_told(wall):
    wall("centre: wide3, width: wide", "(0.0,) * 5")
    with pytest.raises(BrokenPlugin, match="gives 5 numbers, and 4 are taken"):
        dispatch.numbers(Mine())  # pyright: ignore[reportArgumentType]
    with pytest.raises(
        BrokenPlugin, match=r"width of mine_distance is not annotated as a number of a wall; annotate it wide"
    ):
        wall("centre: wide3, width: float", "(0.0,) * 4")
    with pytest.raises(BrokenPlugin, match="mine_rod takes other numbers than mine_distance"):
        wall("centre: wide3, width: wide", "(0.0,) * 4", rod="centre: wide3")


@pytest.mark.parametrize("backend", ["labbook_numba", "labbook_warp"])
def test_what_a_shape_lacks_is_named_with_its_parameters(backend):
    from importlib import import_module

    listed, shapes = import_module(f"{backend}.kernels.shape"), import_module(f"{backend}.shapes").SHAPES
    for name, shape in shapes.items():
        formulas.hold(name, listed, shape.kernels)
    spheres = shapes["sphere"].kernels
    other = import_module(f"{backend}.kernels.{'blocks' if backend == 'labbook_numba' else 'system'}")
    lacking = [module if module.__name__.split(".")[-1] != "spheres" else other for module in spheres]
    with pytest.raises(BrokenPlugin, match=r"the shape disc lacks [a-z_]+\(.*\); define it in one of labbook_"):
        formulas.hold("the shape disc", listed, lacking)


def test_a_function_with_other_parameters_is_told(tmp_path):
    def module(name: str, text: str) -> ModuleType:
        made = ModuleType(name)
        made.__file__ = str(tmp_path / f"{name}.py")
        (tmp_path / f"{name}.py").write_text(text)
        return made

    listed = module("listed", "def near_wall(grains, wall): ...\n")
    formulas.hold("the shape disc", listed, [module("right", "def near_wall(grains, wall): ...\n")])
    with pytest.raises(BrokenPlugin, match=r"wrong.near_wall takes grains, and not grains, wall; see listed"):
        formulas.hold("the shape disc", listed, [module("wrong", "def near_wall(grains): ...\n")])
