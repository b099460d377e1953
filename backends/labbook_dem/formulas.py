"""Modules of formulas, one a contact law or a wall, found by name and held to what each must define."""

import ast
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from labbook.plugins import BrokenPlugin
from labbook_dem.source import module_text, undefined_names


def identifier(name: str) -> str:
    """The name of a law or a wall as Python writes it: `hertz_mindlin` for `hertz-mindlin`."""
    return name.replace("-", "_")


class Formulas(Mapping[str, ModuleType]):
    """Modules by the names that scenes know, each imported when first asked for.

    A type of another package states its module in `physics`; labbook's own types have theirs in `package`, under their
    names. what: the word for them in messages. known: types of scenes, by name. required: the names that the module of
    one of them must define. Raises BrokenPlugin, with the missing name, when a module is asked for.
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
    """Names and annotations, as they are written, of the parameters of a function of a module."""
    for node in ast.parse(module_text(module)).body:
        if isinstance(node, ast.FunctionDef) and node.name == function:
            return tuple((one.arg, ast.unparse(one.annotation) if one.annotation else "") for one in node.args.args)
    raise LookupError(f"{module.__name__} has no function {function}")


def hold(who: str, listed: ModuleType, modules: Sequence[ModuleType]) -> None:
    """Hold modules to the functions that a symbolic module lists.

    Raises BrokenPlugin if one is missing, or takes other parameters; who: whom the message is about.
    """
    for function in _functions(listed):
        wanted = [name for name, _ in parameters_of(listed, function)]
        there = [module for module in modules if function in _functions(module)]
        if not there:
            names = ", ".join(module.__name__ for module in modules)
            raise BrokenPlugin(f"{who} lacks {function}({', '.join(wanted)}); define it in one of {names}")
        for module in there:
            found = [name for name, _ in parameters_of(module, function)]
            if found != wanted:
                told = f"{', '.join(found)}, and not {', '.join(wanted)}"
                raise BrokenPlugin(f"{who}: {module.__name__}.{function} takes {told}; see {listed.__name__}")


@cache
def _functions(module: ModuleType) -> tuple[str, ...]:
    return tuple(node.name for node in ast.parse(module_text(module)).body if isinstance(node, ast.FunctionDef))
