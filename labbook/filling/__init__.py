"""How a run begins: grains placed in the closed container, the bed at rest, and the opening of the outlet."""

from labbook.filling.opening import opened
from labbook.filling.placing import place
from labbook.filling.room import PlacingError

__all__ = ["PlacingError", "opened", "place"]
