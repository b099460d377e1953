"""Warnings for users of Python, at the line of their own code."""

import sys
import warnings
from typing import Any

CodeLine = tuple[str, int]
"""A file and a line in it."""
_OWN = ("labbook", "contextlib")
"""Packages whose lines are not those of a user."""


class LabWarning(UserWarning):
    """Some runs of a study failed or cannot be read, or a number is asked for where little is known of it."""


def caller() -> CodeLine:
    """Line of the user's code that called labbook."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _OWN:
        frame = frame.f_back
    return frame.f_code.co_filename, frame.f_lineno


def called_by_command() -> bool:
    """True if a command of the command line has called, so that messages name its options."""
    frame = sys._getframe(1)
    while frame is not None and (name := frame.f_globals.get("__name__", "")).partition(".")[0] in _OWN:
        if name.startswith("labbook.cli"):
            return True
        frame = frame.f_back
    return False


def warn(message: str, code_line: CodeLine | None = None) -> None:
    """A LabWarning at the line of the user's code, whichever of our functions notices. code_line: None for the
    caller's."""
    warnings.warn_explicit(message, LabWarning, *(code_line or caller()))


class RenamedAttribute:
    """Deprecated name of an attribute: reading it warns and gives the attribute of the new name.

    Args:
        name: The new name.
    """

    def __init__(self, name: str):
        self._name, self._old_name = name, ""

    def __set_name__(self, owner: type, name: str) -> None:
        self._old_name = name

    def __get__(self, instance: object, owner: type | None = None) -> Any:
        if instance is None:
            return self
        message = f"{type(instance).__name__}.{self._old_name} is now called {self._name}"
        warnings.warn_explicit(message, DeprecationWarning, *caller())
        return getattr(instance, self._name)


def rename_in_subclass(subclass: type, old: str, new: str) -> None:
    """Take over an attribute that a subclass, of another package, defines under its former name, and warn.

    Args:
        subclass: The class, as given to `__init_subclass__`.
        old: Former name.
        new: Name that the base class reads.
    """
    if old in vars(subclass) and new not in vars(subclass):
        message = f"{subclass.__name__}.{old} is now called {new}"
        warnings.warn_explicit(message, DeprecationWarning, *caller())
        setattr(subclass, new, vars(subclass)[old])
