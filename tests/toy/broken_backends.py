"""Backends that do what none must do, for tests that the stress suite notices; and cases that hang or crash."""

import os
import time

import numpy as np
from labbook_toy import Backend as Toy
from labbook_toy import Ensemble, Glass

from labbook.backend import Failed, Overflow
from labbook.checks.stress.case import StressCase
from labbook.checks.stress.watch import follow, guard_error, sound
from labbook.checks.verify.materials import G, hertz, room, scene
from labbook.checks.verify.platform import MemberStart, grains_at

START = MemberStart(scene(2, hertz(), room(), G), 1e-5, grains_at([[0.0, 0.0, 0.1], [0.1, 0.0, 0.1]]))


class Faulty(Toy):
    """The toy backend, whose ensembles are of the class `made`."""

    def __init__(self, made: type[Ensemble]):
        super().__init__()
        self.made = made

    def open(self, spec, slots=None, device="cpu"):
        return self.made(self, spec, slots)


class Silent(Ensemble):
    """Says nothing of a velocity that is NaN."""

    def advance(self, beats=1):
        events = super().advance(beats)
        for glass in self.glasses.values():
            glass.v[0, 2] = np.nan
        return events


class Stationary(Ensemble):
    """Takes no steps, and says nothing of it."""

    def advance(self, beats=1):
        return []


class Guarded(Ensemble):
    """A guard stops every member in its first beat, as guards should."""

    guard, message = "overlap", "grain 1 at step 40: overlaps; use a smaller numerics.dt"

    def advance(self, beats=1):
        events = []
        for member, glass in self.glasses.items():
            if not glass.failure:
                glass.failure = (self.guard, 40, 1, self.message)
                events.append(Failed(member, *glass.failure))
                self.harm(glass)
        return events

    def harm(self, glass: Glass) -> None:
        """What a bad guard does to the state."""


class Spoiling(Guarded):
    """Its guard keeps not the last good state."""

    def harm(self, glass):
        glass.x[0] += 1e-9


class Moving(Guarded):
    """Its guard leaves the member at another step."""

    def harm(self, glass):
        glass.count[0] += 40


class Mumbling(Guarded):
    """Its guard names no grain and no remedy."""

    message = "something went wrong"


class Inventive(Guarded):
    """Its guard has a name of its own."""

    guard = "mood"


class Cramped(Ensemble):
    """Its lists are too short, and it says so."""

    def advance(self, beats=1):
        raise Overflow("a grain has 99 near neighbours; use a thinner numerics.skin")


class Raising(Ensemble):
    """Its kernels raise what nobody expects."""

    def advance(self, beats=1):
        raise IndexError("beyond the end")


def runs(platform):
    """A part that has to end right."""
    sound(follow(platform, START, 3, 100))
    yield guard_error("silence", follow(platform, START, 1, 100))


def stops(platform):
    """A part that has to end with a named error."""
    yield guard_error("", follow(platform, START, 3, 100))


def hangs(platform):
    """A case that never ends."""
    while True:
        time.sleep(1)
        yield from ()


def crashes(platform):
    """A case that ends its process, as a wild pointer does."""
    os._exit(11)
    yield


def case(run, seconds: float = 600.0) -> StressCase:
    """A case of this module."""
    return StressCase(name=run.__name__, attempt="", oracle="", run=run, seconds=seconds)
