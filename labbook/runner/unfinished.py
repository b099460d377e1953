"""Unfinished work in a lab: how far it is, and whether somebody is on it."""

from dataclasses import dataclass

from labbook.catalogue.lab import Lab
from labbook.catalogue.parts import Unreadable
from labbook.runner.journal import Progress


@dataclass(frozen=True)
class Unfinished:
    """Work on one key of a run or packing."""

    key: str
    step: int
    """Of the last save."""
    saved: bool
    held: bool
    """Whether a process is working on it."""
    problem: str | None = None
    """Why its last save cannot be read."""


def unfinished(lab: Lab) -> list[Unfinished]:
    """All unfinished work."""
    found = []
    for key in lab.working():
        last, problem = None, None
        try:
            last = Progress.read(lab.work(key))
        except Unreadable as error:
            problem = str(error)
        step = last.step if last else 0
        found.append(Unfinished(key, step, last is not None, lab.held(key), problem))
    return found
