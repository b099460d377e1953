"""Unfinished work in a lab: how far it is, and whether somebody is on it."""

import json
from dataclasses import dataclass

from labbook.catalogue.lab import Lab
from labbook.runner.journal import PROGRESS


@dataclass(frozen=True)
class Unfinished:
    """Work on one key of a run or packing."""

    key: str
    step: int
    """Of the last save."""
    saved: bool
    held: bool
    """Whether a process is working on it."""


def unfinished(lab: Lab) -> list[Unfinished]:
    """All unfinished work."""
    found = []
    for key in lab.working():
        try:
            step, saved = int(json.loads((lab.work(key) / PROGRESS).read_bytes())["state"]["step"]), True
        except (OSError, ValueError, KeyError, TypeError):
            step, saved = 0, False
        found.append(Unfinished(key, step, saved, lab.held(key)))
    return found
