"""From modules in the vocabulary of `words` to the source of one self-contained module for a compiler.

Functions keep their text; what goes are docstrings of modules and imports (of words, of one another, and the host's).
Host functions, those not marked for a compiler, stay behind, whatever other decorators they have. Whole numbers with
names in capitals, which functions of the physics use, become constants of the generated module.
"""

import ast
import builtins
import re
import symtable
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType

from labbook.plugins import BrokenPlugin

MARKS = frozenset({"func", "rare_func", "struct", "kernel", "hot_kernel", "wall_kernel", "entry"})
"""Decorators of compiled code: `func` and `struct` of words, and the kernels of backends."""


def device_source(module: ModuleType) -> str:
    """Functions and records of a module that are marked for a compiler, as text.

    Raises:
        ValueError: one of them has a second decorator, which a compiler would not know.
    """
    return _marked_parts(module_text(module))


@cache
def _marked_parts(text: str) -> str:
    lines = text.split("\n")
    return "\n\n".join(
        "\n".join(lines[node.decorator_list[0].lineno - 1 : node.end_lineno]) for node in _marked_nodes(text)
    )


def _marked_nodes(text: str) -> list[ast.FunctionDef | ast.ClassDef]:
    body = ast.parse(text).body
    return [node for node in body if isinstance(node, ast.FunctionDef | ast.ClassDef) and _marked(node)]


def named_numbers(modules: Sequence[ModuleType]) -> dict[str, int]:
    """Whole numbers that compiled functions of these modules use by a name in capitals, such as places of coefficients
    (`labbook_dem.coefficients`).

    Raises:
        BrokenPlugin: two modules use a name for different numbers.
    """
    numbers: dict[str, int] = {}
    for module in modules:
        # Sorted: the generated text, and so the folder of its compiled code, must not depend on the order of a set.
        for name in sorted(_capitals(module_text(module))):
            value = vars(module).get(name)
            if type(value) is int and numbers.setdefault(name, value) != value:
                first, reason = numbers[name], "one kernel has the formulas of both"
                raise BrokenPlugin(
                    f"{module.__name__}: {name} is {value}, and {first} in another module; {reason}: rename it"
                )
    return numbers


@cache
def _capitals(text: str) -> frozenset[str]:
    """Names in capitals that compiled functions read."""
    nodes = (node for marked in _marked_nodes(text) for node in ast.walk(marked))
    return frozenset(node.id for node in nodes if isinstance(node, ast.Name) and node.id.isupper())


def undefined_names(module: ModuleType) -> list[tuple[str, int]]:
    """Names, with their lines, that compiled functions of a module read and that neither it nor Python defines."""
    text = module_text(module)
    marked = {node.name: node for node in _marked_nodes(text)}
    missing: list[tuple[str, int]] = []
    for table in symtable.symtable(text, module.__name__, "exec").get_children():
        node = marked.get(table.get_name())
        if node is None or not isinstance(table, symtable.Function):
            continue
        for name in table.get_globals():
            if not (name in vars(module) or hasattr(builtins, name)):
                lines = [use.lineno for use in ast.walk(node) if isinstance(use, ast.Name) and use.id == name]
                missing.append((name, min(lines, default=node.lineno)))
    return sorted(missing, key=lambda place: place[1])


def module_text(module: ModuleType) -> str:
    """The source of a module."""
    assert module.__file__ is not None
    return Path(module.__file__).read_text(encoding="utf-8")


def _marked(node: ast.FunctionDef | ast.ClassDef) -> bool:
    """True if marked for a compiler. Raises ValueError for a mark beside another decorator."""
    names = [ast.unparse(decorator) for decorator in node.decorator_list]
    if MARKS.isdisjoint(names):
        return False
    if len(names) > 1:
        raise ValueError(f"{node.name}: {', '.join(names)}: a function that is compiled has one decorator")
    return True


def without(text: str, switch: str) -> str:
    """Source without the branches `if SWITCH:`; what follows their `else` takes their place."""
    branches = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.If)]
    lines = text.split("\n")
    # From the last branch to the first, so that line numbers of those before stay valid.
    for node in sorted(branches, key=lambda node: node.lineno, reverse=True):
        if isinstance(node.test, ast.Name) and node.test.id == switch:
            alternative = lines[node.orelse[0].lineno - 1 : node.end_lineno] if node.orelse else []
            lines[node.lineno - 1 : node.end_lineno] = [line[4:] for line in alternative]
    return "\n".join(lines)


def generate(
    header: str,
    constants: Mapping[str, object],
    physics: Sequence[ModuleType],
    kernels: Sequence[ModuleType | str] = (),
) -> str:
    """Write one module: header, constants, then the device functions of physics and kernels, each part headed by its
    source.

    Args:
        header: vocabulary of a compiler.
        constants: values by name. The `named_numbers` of the physics are added.
        physics: modules of formulas.
        kernels: modules, or text that is copied.

    Raises:
        BrokenPlugin: a number of the physics has a name of `header` or `constants`.
    """
    numbers = named_numbers(physics)
    for name in numbers:
        if name in constants or re.search(rf"^{name}\b", header, re.MULTILINE):
            where = next(module.__name__ for module in physics if name in _capitals(module_text(module)))
            raise BrokenPlugin(f"{where}: kernels use the name {name} for something else; rename it")
    assignments = "\n".join(f"{name} = {value!r}" for name, value in {**constants, **numbers}.items())
    parts = [
        part if isinstance(part, str) else f"# {part.__name__}\n{device_source(part)}" for part in (*physics, *kernels)
    ]
    return "\n\n".join([header, assignments, *parts]) + "\n"
