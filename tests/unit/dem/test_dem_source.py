"""What of a module is taken to a compiler."""

from types import ModuleType
from typing import Any

import pytest
from labbook_dem import source
from one_source import device_functions

from labbook.plugins import BrokenPlugin

MIXED = """
from functools import lru_cache
from labbook_dem.words import func, real


@lru_cache(maxsize=8)
def table(n):
    return [twice(real(k)) for k in range(n)]


@func
def twice(a: real):
    return real(2.0) * a


def plain(a):
    return a


@kernel
def loop(x):
    x[0] = twice(x[0])
"""


def test_only_marked_functions_are_taken_to_the_compiler(tmp_path):
    module = ModuleType("mixed")
    module.__file__ = str(tmp_path / "mixed.py")
    (tmp_path / "mixed.py").write_text(MIXED)
    assert device_functions(module) == ["twice", "loop"]
    assert source.device_source(module).startswith("@func\ndef twice")
    assert "lru_cache" not in source.generate("", {}, [module])
    (tmp_path / "mixed.py").write_text(MIXED.replace("@func", "@lru_cache(maxsize=8)\n@func"))
    with pytest.raises(ValueError, match=r"twice: .* has one decorator"):
        source.device_source(module)


def test_a_host_module_with_cached_functions_has_nothing_to_compile():
    from labbook_dem import describe

    assert source.device_source(describe) == ""


LAW = """
from labbook_dem.coefficients import MU, OWN
from labbook_dem.words import func

{name}, UNUSED = OWN[:2]
VERSION = 3


def host(law):
    return VERSION


@func
def normal(c, delta):
    return c[{name}] * delta * c[MU]
"""


@pytest.fixture
def law(tmp_path):
    """A module of LAW, whose coefficient has the given name."""

    def written(module: str, name: str) -> ModuleType:
        made = ModuleType(module)
        made.__file__ = str(tmp_path / f"{module}.py")
        (tmp_path / f"{module}.py").write_text(text := LAW.format(name=name))
        exec(text, vars(made))
        return made

    return written


def test_names_of_coefficients_are_constants_of_the_generated_module(law):
    made = law("adhesive", "SURFACE_ENERGY")
    text = source.generate("", {"KINDS": 2}, [made])
    assert {"KINDS = 2", "MU = 4", "SURFACE_ENERGY = 0"} <= set(text.splitlines())
    assert "UNUSED" not in text
    assert "VERSION" not in text
    scope: dict[str, Any] = {"func": lambda function: function}
    exec(text, scope)
    c = (5.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0)
    assert scope["normal"](c, 3.0) == made.normal(c, 3.0) == 7.5


@pytest.mark.parametrize(("header", "constants"), [("LANES = 16", {}), ("", {"LANES": 16})])
def test_a_name_that_kernels_use_for_something_else_is_refused(law, header, constants):
    with pytest.raises(BrokenPlugin, match="adhesive: kernels use the name LANES for something else; rename it"):
        source.generate(header, constants, [law("adhesive", "LANES")])


def test_one_name_for_two_numbers_is_refused(law):
    other = law("other", "ENERGY")
    vars(other)["ENERGY"] = 6
    with pytest.raises(BrokenPlugin, match="other: ENERGY is 6, and 0 in another module"):
        source.generate("", {}, [law("adhesive", "ENERGY"), other])


SWITCHED = """@func
def pushed(x: real, by: real):
    y = x
    if MOVES:
        y = x + by
        if y > by:
            y = by
    else:
        if x > by:
            y = by
    if HEAVY:
        y = y + x
    if MOVES:
        y = y - by
    return y
"""


def test_branches_of_a_switch_are_left_out_of_a_source():
    """What is left gives what the whole gives with the switch off, and does not read it."""
    left = source.without(SWITCHED, "MOVES")
    assert "MOVES" not in left
    results = []
    for text in (SWITCHED, left):
        names = {"func": lambda f: f, "real": float, "MOVES": False, "HEAVY": True}
        exec(text, names)  # pyright: ignore[reportArgumentType]
        results.append([names["pushed"](x, 2.0) for x in (1.0, 2.0, 3.0)])  # pyright: ignore[reportCallIssue]
    assert results[0] == results[1] == [2.0, 4.0, 5.0]
    assert source.without(left, "MOVES") == left
