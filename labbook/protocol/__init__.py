"""How a run begins: filling, opening, and the packings that come of it."""

from labbook.protocol.bodies import Bodies
from labbook.protocol.opening import opened
from labbook.protocol.packing import Packing
from labbook.protocol.placing import PlacingError, place

__all__ = ["Bodies", "Packing", "PlacingError", "opened", "place"]
