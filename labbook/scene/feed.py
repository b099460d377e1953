"""Feeding a silo while it flows, so that it stays as full as it is."""

from typing import ClassVar, Literal

from labbook.scene.model import Model


class Feed(Model):
    """What becomes of grains that left through the outlet."""

    version: ClassVar[int] = 1
    """Part of the key of every fed run; it rises whenever a seed puts grains to other places than before."""

    kind: Literal["reinject"]
    """`reinject`: grains that left fall onto the bed again, from random free places above it."""
