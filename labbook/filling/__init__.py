"""How a run begins, and how it is fed: grains placed in the closed container, the bed at rest, friction of walls that
is mobilised before the opening, the opening of the outlet, the kick of a further discharge of the same bed, grains that
come back, and arches that are broken."""

from labbook.filling.breaking import Breaker, still
from labbook.filling.feeding import Feeder, Refill, refill
from labbook.filling.from_file import GrainFile
from labbook.filling.kick import Kick, kicked
from labbook.filling.mobilising import Mobilise, lifted
from labbook.filling.opening import opened
from labbook.filling.placing import place
from labbook.filling.pouring import Inflow, Pouring
from labbook.filling.room import PlacingError

__all__ = [
    "Breaker",
    "Feeder",
    "GrainFile",
    "Inflow",
    "Kick",
    "Mobilise",
    "PlacingError",
    "Pouring",
    "Refill",
    "kicked",
    "lifted",
    "opened",
    "place",
    "refill",
    "still",
]
