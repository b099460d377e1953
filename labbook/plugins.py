"""What packages from outside add to labbook: they announce it by entry points, as the bundled backends and papers do.

A measure, a fit or a paper of another package stands in its `pyproject.toml`:

    [project.entry-points."labbook.measures"]
    wall_force = "my_package.wall_force:WallForce"

The object is a class without arguments, or an instance; of contact laws and walls it is the class itself
(`labbook.scene.model.TaggedModels`). It is loaded when its registry is first asked for something.
"""

from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from importlib.metadata import entry_points
from typing import Any, Generic, TypeVar

_T = TypeVar("_T")
_OWN = "labbook"
"""The distribution that announces what is bundled, and how all groups of entry points begin."""


def extensions() -> dict[str, str]:
    """Name and version of every installed distribution, beside labbook's own, that announces an entry point in one of
    labbook's groups. Their code can change numbers."""
    entries = (
        entry for group in entry_points().groups if group.startswith(f"{_OWN}.") for entry in entry_points(group=group)
    )
    found = {entry.dist.name: entry.dist.version for entry in entries if entry.dist is not None}
    return {name: version for name, version in sorted(found.items()) if name != _OWN}


class BrokenPlugin(Exception):
    """Something that a package announces cannot be loaded; the message says what, why, and what to do."""


class Registry(Mapping[str, _T], Generic[_T]):
    """What is built in and what other packages add in the entry-point group `group`, by name, in that order.

    `kind`: the class that all must be of, each with a `name`. Raises BrokenPlugin when it is first asked, for something
    that cannot be loaded, is of another kind, or has a name that is taken.
    """

    def __init__(self, group: str, kind: type, builtin: Iterable[_T]):
        self._group, self._kind, self._builtin = group, kind, tuple(builtin)

    @cached_property
    def _found(self) -> dict[str, _T]:
        found = {self._name(one): one for one in self._builtin}
        for entry in sorted(entry_points(group=self._group), key=lambda entry: entry.name):
            one = self._load(entry)
            if (name := self._name(one)) in found:
                raise BrokenPlugin(f"{self._said(entry)}: another package provides {name}; uninstall one of the two")
            found[name] = one
        return found

    def _name(self, one: Any) -> str:
        return one.name

    def _made(self, loaded: Any) -> Any:
        """What is registered of what an entry point names; None if it is of another kind."""
        one = loaded() if isinstance(loaded, type) else loaded
        return one if isinstance(one, self._kind) else None

    def _load(self, entry: Any) -> _T:
        try:
            made = self._made(entry.load())
        except Exception as error:  # whatever a package does when it is imported
            why = f"it cannot be loaded ({type(error).__name__}: {error})"
            raise BrokenPlugin(f"{self._said(entry)}: {why}; fix or uninstall the package") from error
        if made is None:
            raise BrokenPlugin(f"{self._said(entry)}: it is not a {self._kind.__name__}; fix or uninstall the package")
        return made

    def _said(self, entry: Any) -> str:
        package = f" of {entry.dist.name}" if entry.dist is not None else ""
        return f"{entry.value}{package}, announced in {self._group}"

    def __getitem__(self, name: str) -> _T:
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)
