"""Modules of formulas, one a contact law or a wall: found by name, and checked for their definitions."""

import ast
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from labbook.plugins import BrokenPlugin
from labbook_dem.source import module_text, undefined_names


def identifier(name: str) -> str:
    """Name of a law or a wall as a Python identifier: `hertz_mindlin` for `hertz-mindlin`."""
    return name.replace("-", "_")


class Formulas(Mapping[str, ModuleType]):
    """Modules by the names of scenes, each imported at first use.

    A type of another package states its module in `physics`; labbook's own types have theirs in `package`, under their
    names.

    Args:
        what: word for the kind in messages.
        package: package of labbook's own modules.
        known: types of scenes by name.
        required: names that the module of a type must define.

    Raises:
        BrokenPlugin: at the use of a module that is missing, or lacks a name.
    """

    def __init__(self, what: str, package: str, known: Mapping[str, type], required: Callable[[str], Sequence[str]]):
        self._what, self._package, self._known, self._required = what, package, known, required
        self._found: dict[str, ModuleType] = {}

    def __getitem__(self, name: str) -> ModuleType:
        if name not in self._found:
            self._found[name] = self._load(name, self._known[name])
        return self._found[name]

    def _load(self, name: str, kind: type) -> ModuleType:
        where = getattr(kind, "physics", f"{self._package}.{identifier(name)}")
        if not hasattr(kind, "physics") and find_spec(where) is None:
            remedy = f"state the module of its formulas in {kind.__module__}.{kind.__name__}.physics"
            raise BrokenPlugin(f"the {self._what} {name} has no formulas: {remedy}")
        try:
            module = import_module(where)
        except ImportError as error:
            raise BrokenPlugin(f"the {self._what} {name}: its formulas cannot be loaded ({error})") from error
        missing = [one for one in self._required(name) if not hasattr(module, one)]
        if missing:
            raise BrokenPlugin(f"the {self._what} {name}: {where} lacks {', '.join(missing)}; define it there")
        if hasattr(kind, "physics"):  # of another package; tests compile those of labbook
            for undefined, line in undefined_names(module):
                raise BrokenPlugin(f"the {self._what} {name}: {where}, line {line}: {undefined} is not defined")
        return module

    def __iter__(self) -> Iterator[str]:
        return iter(self._known)

    def __len__(self) -> int:
        return len(self._known)


@cache
def parameters_of(module: ModuleType, function: str) -> tuple[tuple[str, str], ...]:
    """Names and annotations, as written, of the parameters of a function of a module."""
    for node in ast.parse(module_text(module)).body:
        if isinstance(node, ast.FunctionDef) and node.name == function:
            return tuple((arg.arg, ast.unparse(arg.annotation) if arg.annotation else "") for arg in node.args.args)
    raise LookupError(f"{module.__name__} has no function {function}")


def hold(subject: str, listed: ModuleType, modules: Sequence[ModuleType]) -> None:
    """Check that modules define the functions of a symbolic module, with its parameters.

    Args:
        subject: subject of messages.
        listed: symbolic module.
        modules: modules that define the functions between them.

    Raises:
        BrokenPlugin: a function is missing, or takes other parameters.
    """
    for function in _functions(listed):
        required = [name for name, _ in parameters_of(listed, function)]
        defining = [module for module in modules if function in _functions(module)]
        if not defining:
            names = ", ".join(module.__name__ for module in modules)
            raise BrokenPlugin(f"{subject} lacks {function}({', '.join(required)}); define it in one of {names}")
        for module in defining:
            parameters = [name for name, _ in parameters_of(module, function)]
            if parameters != required:
                difference = f"{', '.join(parameters)}, and not {', '.join(required)}"
                raise BrokenPlugin(f"{subject}: {module.__name__}.{function} takes {difference}; see {listed.__name__}")


@cache
def _functions(module: ModuleType) -> tuple[str, ...]:
    return tuple(node.name for node in ast.parse(module_text(module)).body if isinstance(node, ast.FunctionDef))
