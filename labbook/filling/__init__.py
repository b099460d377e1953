"""How a run begins, and how it is fed: grains placed in the closed container, the bed at rest, the opening of the
outlet, the kick of a further discharge of the same bed, and grains that come back."""

from labbook.filling.feeding import Feeder
from labbook.filling.kick import Kick, kicked
from labbook.filling.opening import opened
from labbook.filling.placing import place
from labbook.filling.room import PlacingError

__all__ = ["Feeder", "Kick", "PlacingError", "kicked", "opened", "place"]
