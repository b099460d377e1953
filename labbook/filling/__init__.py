"""Filling and feeding: placing of grains in the closed container, rest of the bed, mobilised wall friction, opening of
the outlet, kick of a further discharge of a bed, return of grains, and breaking of arches."""

from labbook.filling.breaking import Breaker, still
from labbook.filling.feeding import Feeder, Refill, refill
from labbook.filling.from_file import GrainFile
from labbook.filling.kick import Kick, kick_grains
from labbook.filling.mobilising import Mobilise, lifted
from labbook.filling.opening import start_of_discharge
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
    "kick_grains",
    "lifted",
    "place",
    "refill",
    "start_of_discharge",
    "still",
]
