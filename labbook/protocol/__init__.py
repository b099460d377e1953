"""How a run begins: filling, opening, and the packings that come of it."""

from labbook.protocol.opening import opened
from labbook.protocol.packing import Packing
from labbook.protocol.placing import PlacingError, place

__all__ = ["Packing", "PlacingError", "opened", "place"]
