"""From modules in the vocabulary of `words` to the source of one self-contained module for a compiler.

Functions keep their text; what goes are docstrings of modules and imports (of words, of one another, and the host's).
Host functions, those without a decorator, stay behind. Only modules written for it may be passed.
"""

import ast
from pathlib import Path
from types import ModuleType


def device_source(module: ModuleType) -> str:
    """The decorated functions and records of a module, as text."""
    text = _text(module)
    parts = [ast.get_source_segment(text, node, padded=True) or "" for node in _device_functions(ast.parse(text))]
    return "\n\n".join(parts)


def _text(module: ModuleType) -> str:
    assert module.__file__ is not None
    return Path(module.__file__).read_text(encoding="utf-8")


def _device_functions(tree: ast.Module):
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.decorator_list:
            # get_source_segment leaves decorators out; start the node at its first decorator
            node.lineno = node.decorator_list[0].lineno
            node.col_offset = node.decorator_list[0].col_offset - 1
            yield node


def generate(header: str, constants: dict[str, object], modules: list[ModuleType]) -> str:
    """One module: `header` (a compiler's vocabulary), `constants` as assignments, then all device functions."""
    assignments = "\n".join(f"{name} = {value!r}" for name, value in constants.items())
    return "\n\n".join([header, assignments, *(device_source(module) for module in modules)]) + "\n"
