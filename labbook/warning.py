"""Warnings for users of Python, at the line of their own code."""

import sys
import warnings

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
