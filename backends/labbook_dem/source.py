"""From modules in the vocabulary of `words` to the source of one self-contained module for a compiler.

Functions keep their text; what goes are docstrings of modules and imports (of words, of one another, and the host's).
Host functions, those not marked for a compiler, stay behind, whatever other decorators they have.
"""

import ast
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import ModuleType

MARKS = frozenset({"func", "rare_func", "struct", "kernel", "hot_kernel", "wall_kernel", "entry"})
"""Decorators of what is compiled: `func` and `struct` of words, and the kernels of backends."""


def device_source(module: ModuleType) -> str:
    """The functions and records of a module that are marked for a compiler, as text.

    Raises ValueError if one of them has another decorator beside its mark, which a compiler would not know.
    """
    return _marked_parts(module_text(module))


@cache
def _marked_parts(text: str) -> str:
    lines = text.split("\n")
    nodes = [
        node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef | ast.ClassDef) and _marked(node)
    ]
    return "\n\n".join("\n".join(lines[node.decorator_list[0].lineno - 1 : node.end_lineno]) for node in nodes)


def module_text(module: ModuleType) -> str:
    """The source of a module."""
    assert module.__file__ is not None
    return Path(module.__file__).read_text(encoding="utf-8")


def _marked(node: ast.FunctionDef | ast.ClassDef) -> bool:
    names = [ast.unparse(decorator) for decorator in node.decorator_list]
    if MARKS.isdisjoint(names):
        return False
    if len(names) > 1:
        raise ValueError(f"{node.name}: {', '.join(names)}: a function that is compiled has one decorator")
    return True


def generate(header: str, constants: dict[str, object], modules: Sequence[ModuleType | str]) -> str:
    """One module: `header` (a compiler's vocabulary), `constants` as assignments, then all device functions of modules,
    with a line that says where they stand, and text as it is."""
    assignments = "\n".join(f"{name} = {value!r}" for name, value in constants.items())
    parts = [
        module if isinstance(module, str) else f"# {module.__name__}\n{device_source(module)}" for module in modules
    ]
    return "\n\n".join([header, assignments, *parts]) + "\n"
