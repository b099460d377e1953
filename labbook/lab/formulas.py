"""The source of an extension's contact law or wall, as a hash: edited formulas are noticed without a new version.

Comments, docstrings and line breaks do not count. All else in the modules does, also what only plans use: a run too
many costs less than a wrong one.
"""

import ast
import hashlib
import threading
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.util import find_spec, resolve_name
from pathlib import Path
from typing import Any

from labbook.scene import ContactLaw
from labbook.scene.walls import WallShape

LENGTH = 24
"""Hexadecimal digits of a hash."""
_NOT_FOLLOWED = ("labbook", "pydantic", "typing", "abc", "builtins")
_reading = threading.RLock()  # before Python 3.11.8 its parser may fail in two threads at once


@cache
def source_hash(kind: type[ContactLaw] | type[WallShape]) -> str:
    """Hash the source of a law or a wall of another package.

    It covers the modules of its class, of the base classes and of its formulas, and all modules of the same packages
    that these import. They are read once in a process: an edit takes effect when Python is started again.
    """
    roots = {base.__module__ for base in kind.__mro__} | {kind.physics}
    roots = {name for name in roots if not _is_ours(name)}
    packages = {name.partition(".")[0] for name in roots}
    with _reading:
        contents = _modules(roots, packages)
    parts = [part for name in sorted(contents) for part in (name, contents[name])]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:LENGTH]


def _is_ours(module: str) -> bool:
    """Return True for modules of labbook and of libraries: their versions are recorded instead."""
    package = module.partition(".")[0]
    return package in _NOT_FOLLOWED or package.startswith("labbook_")


def _modules(roots: Iterable[str], packages: Iterable[str]) -> dict[str, str]:
    """The content of modules and of those that they import from `packages`, by name."""
    contents: dict[str, str] = {}
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name in contents or (path := _file(name)) is None:
            continue
        if path.suffix != ".py":
            contents[name] = hashlib.sha256(path.read_bytes()).hexdigest()
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        contents[name] = without_comments(tree)
        within = name if path.name == "__init__.py" else name.rpartition(".")[0]
        waiting += [one for one in _imports(tree, within) if one.partition(".")[0] in packages]
    return contents


def _file(module: str) -> Path | None:
    """The file of a module; None of one that has none."""
    try:
        spec = find_spec(module)
    except (ImportError, ValueError):
        return None
    return Path(spec.origin) if spec is not None and spec.has_location and spec.origin else None


def _imports(tree: ast.AST, within: str) -> Iterator[str]:
    """Names of the modules that a module in the package `within` imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            source = resolve_name("." * node.level + (node.module or ""), within) if node.level else node.module or ""
            modules = [f"{source}.{alias.name}" for alias in node.names]
            there = [name for name in modules if not _is_ours(name) and _file(name) is not None]
            yield from there
            if len(there) < len(modules):  # a name that the package itself defines
                yield source


def without_comments(node: Any) -> str:
    """Dump a syntax tree as text, without docstrings and other strings that stand alone.

    The text does not depend on the version of Python, if all versions parse the source in the same way.
    """
    if isinstance(node, list):
        return f"[{','.join([without_comments(item) for item in node if not _is_comment(item)])}]"
    if not isinstance(node, ast.AST):
        return repr(node)
    parts = [
        f"{name}={without_comments(value)}"
        for name, value in ast.iter_fields(node)
        if value is not None and value != [] and name not in ("kind", "type_comment")
    ]
    return f"{type(node).__name__}({','.join(parts)})"


def _is_comment(node: Any) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
