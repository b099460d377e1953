"""Extensions: what other packages add to labbook. They announce it by entry points, as bundled backends and papers do.

A measure of another package stands in its `pyproject.toml`:

    [project.entry-points."labbook.measures"]
    wall_force = "my_package.wall_force:WallForce"

`KINDS` lists the groups. The object is an instance, or a class that takes no arguments; of contact laws and walls it is
the class itself (`labbook.scene.model.TaggedModels`). It is loaded when its registry is first used.
"""

import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import entry_points
from inspect import get_annotations
from pathlib import Path
from types import FrameType
from typing import Any, ClassVar, Generic, TypeVar, get_origin

_T = TypeVar("_T")
_OWN = "labbook"
"""The distribution that announces what is bundled, and how all groups of entry points begin."""

KINDS = {
    "labbook.contact_laws": "contact law",
    "labbook.walls": "wall",
    "labbook.starts": "start",
    "labbook.measures": "measure",
    "labbook.laws": "flow law",
    "labbook.strategies": "strategy",
    "labbook.papers": "paper",
    "labbook.cases": "case",
    "labbook.backends": "backend",
    "labbook.verbs": "verb",
}
"""The word for an entry of each group in messages and pages. A contact law gives forces, a flow law W(D); the further
fits that a paper adds belong to the paper."""


@dataclass(frozen=True)
class Extension:
    """Entry point of another package.

    Args:
        group: Group of entry points, such as `labbook.laws`.
        name: Name of the object.
        package: Package that announces it.
        version: Version of the package.
        module: Module that the entry names.
    """

    group: str
    name: str
    package: str
    version: str
    module: str = field(compare=False)

    @property
    def use(self) -> str:
        """Kind and name: `contact law viscous`."""
        return f"{KINDS.get(self.group, 'entry')} {self.name}"

    @property
    def made_by(self) -> str:
        """Package and version: `bed-extras 0.1`."""
        return f"{self.package} {self.version}".strip()

    def __str__(self) -> str:
        return f"{self.use} of {self.made_by}"

    @classmethod
    def of(cls, entry: Any, name: str = "") -> "Extension | None":
        """Read an entry point.

        Args:
            entry: Entry point of `importlib.metadata`.
            name: Name of the object; empty: that of the entry.

        Returns:
            The extension; None if labbook itself announces the entry.
        """
        package, version = (entry.dist.name, entry.dist.version) if entry.dist is not None else (entry.module, "")
        return None if package == _OWN else cls(entry.group, name or entry.name, package, version, entry.module)


def installed() -> tuple[Extension, ...]:
    """All entries that packages beside labbook announce in its groups, by package; none is imported."""
    groups = [group for group in sorted(entry_points().groups) if group.startswith(f"{_OWN}.")]
    entries = (Extension.of(entry) for group in groups for entry in entry_points(group=group))
    extensions = {entry for entry in entries if entry is not None}
    return tuple(sorted(extensions, key=lambda extension: (extension.package, extension.group, extension.name)))


class BrokenPlugin(Exception):
    """Something that a package announces cannot be used; the message says what, why, and what to do."""


class ExtensionError(BrokenPlugin):
    """The code of an extension has raised an exception, which is the cause of this one.

    The message names the extension, its package, the exception, and the line of the package that raised it.
    """

    def __init__(self, extension: Extension, error: BaseException):
        frame = _frame_of(error, _package_of(extension.module))
        location = f" ({_location_text(*frame)})" if frame else ""
        super().__init__(f"{extension}: {type(error).__name__}: {error}{location}")
        self.extension = extension


def blamed(error: BaseException) -> ExtensionError | None:
    """Attribute an error to the extension whose code raised it.

    Extensions call labbook and other libraries: the innermost frame of a loaded extension counts.

    Args:
        error: The error, with its traceback.

    Returns:
        The error with the name of the extension; None if no code of an extension is in the traceback.
    """
    for package, extensions in _loaded.items():
        if (location := _frame_of(error, package)) is not None:
            module = location[0].f_globals.get("__name__")
            of_module = (extension for extension in extensions if extension.module == module)
            return ExtensionError(next(of_module, extensions[0]), error)
    return None


_loaded: dict[str, list[Extension]] = {}
"""By top-level package: the extensions whose code this process has imported."""


def loaded_sources() -> tuple[tuple[str, int], ...]:
    """List the files of extensions that this process has imported, each with the time of its last change [ns]."""
    modules = [module for name, module in sys.modules.copy().items() if _package_of(name) in _loaded]
    files = {file for module in modules if (file := getattr(module, "__file__", None)) is not None}
    return tuple((file, os.stat(file).st_mtime_ns) for file in sorted(files) if os.path.exists(file))


def _package_of(module: str) -> str:
    return module.partition(".")[0]


def _frame_of(error: BaseException, package: str) -> tuple[FrameType, int] | None:
    """The innermost frame of a package in a traceback, and its line."""
    innermost, trace = None, error.__traceback__
    while trace is not None:
        if _package_of(str(trace.tb_frame.f_globals.get("__name__"))) == package:
            innermost = trace.tb_frame, trace.tb_lineno
        trace = trace.tb_next
    return innermost


def _location_text(frame: FrameType, line: int) -> str:
    """`bed_extras/viscous.py, line 31`."""
    package, path = _package_of(str(frame.f_globals["__name__"])), Path(frame.f_code.co_filename)
    parts = path.parts[path.parts.index(package) :] if package in path.parts else path.parts[-1:]
    return f"{'/'.join(parts)}, line {line}"


class Registry(Mapping[str, _T], Generic[_T]):
    """Objects by name: those built in, then those that other packages announce in a group of entry points.

    The first use loads the packages. It raises BrokenPlugin for an entry that cannot be loaded, is of another class,
    lacks abstract methods or class variables, or has a name that is taken.
    """

    def __init__(self, group: str, kind: type, builtin: Iterable[_T]):
        """Declare a registry.

        Args:
            group: Group of entry points.
            kind: Class that all objects are of, each with a `name`.
            builtin: Objects of labbook itself.
        """
        self._group, self._kind, self._builtin = group, kind, tuple(builtin)

    @cached_property
    def _objects(self) -> dict[str, _T]:
        return self._entries[0]

    @cached_property
    def _entries(self) -> tuple[dict[str, _T], dict[str, Extension]]:
        """Objects by name, and the extensions among them."""
        objects, extensions = {self._name(entry): entry for entry in self._builtin}, dict[str, Extension]()
        for entry in sorted(entry_points(group=self._group), key=lambda entry: entry.name):
            name, loaded = self._load(entry)
            if name in objects:
                raise BrokenPlugin(f"{self._origin(entry)}: another package provides {name}; uninstall one of the two")
            objects[name] = loaded
            if (extension := Extension.of(entry, name)) is not None:
                extensions[name] = extension
                _loaded.setdefault(_package_of(entry.module), []).append(extension)
        return objects, extensions

    @property
    def extensions(self) -> Mapping[str, Extension]:
        """The extensions in it, by name; labbook's own objects are not among them."""
        return self._entries[1]

    @contextmanager
    def calling(self, name: str, *passing: type[Exception]) -> Iterator[None]:
        """Context for a call of the code of an object, in which exceptions are attributed to its package.

        Exceptions of labbook's own objects stay as they are: those are errors of labbook, which need their traceback.

        Args:
            name: Name of the object.
            passing: Exceptions that stay as they are, beside those of the machine (ImportError, OSError, MemoryError).

        Raises:
            ExtensionError: The code of an extension raised another exception.
        """
        try:
            yield
        except (*passing, ExtensionError, ImportError, OSError, MemoryError):
            raise
        except Exception as error:
            if (extension := self.extensions.get(name)) is None:
                raise
            raise ExtensionError(extension, error) from error

    def _name(self, one: Any) -> str:
        return one.name

    def _object_of(self, loaded: Any) -> Any:
        """Object to register for a loaded entry, which may be a class; None if it is of another kind."""
        instance = loaded() if isinstance(loaded, type) else loaded
        return instance if isinstance(instance, self._kind) else None

    def _load(self, entry: Any) -> tuple[str, _T]:
        try:
            loaded = entry.load()
        except Exception as error:  # whatever a package does when it is imported
            raise self._broken(entry, error) from error
        kind = loaded if isinstance(loaded, type) else type(loaded)
        if issubclass(kind, self._kind) and (missing := required(kind)):
            raise BrokenPlugin(
                f"{self._origin(entry)}: it lacks {', '.join(missing)}; define that in {kind.__qualname__}"
            )
        try:
            instance = self._object_of(loaded)
            name = "" if instance is None else self._name(instance)
        except Exception as error:  # whatever its class does
            raise self._broken(entry, error) from error
        if instance is None:
            reason = f"it is not a {self._kind.__name__}"
            raise BrokenPlugin(f"{self._origin(entry)}: {reason}; fix or uninstall the package")
        return name, instance

    def _broken(self, entry: Any, error: Exception) -> BrokenPlugin:
        why = f"it cannot be loaded ({type(error).__name__}: {error})"
        return BrokenPlugin(f"{self._origin(entry)}: {why}; fix or uninstall the package")

    def _origin(self, entry: Any) -> str:
        package = f" of {entry.dist.name}" if entry.dist is not None else ""
        return f"{entry.value}{package}, announced in {self._group}"

    def __getitem__(self, name: str) -> _T:
        return self._objects[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._objects)

    def __len__(self) -> int:
        return len(self._objects)


def required(kind: type) -> tuple[str, ...]:
    """Names that a class still has to define: class variables without a value, and abstract methods.

    Args:
        kind: The class.

    Returns:
        The names.
    """
    variables = [
        name
        for base in reversed(kind.__mro__)
        for name, annotation in get_annotations(base).items()
        if get_origin(annotation) is ClassVar and not hasattr(kind, name)
    ]
    return (*dict.fromkeys(variables), *sorted(getattr(kind, "__abstractmethods__", ())))
