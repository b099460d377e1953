"""What of a module is taken to a compiler."""

from types import ModuleType

import pytest
from labbook_dem import source
from one_source import device_functions

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
