"""Beds that have settled."""

from labbook.backend import Backend, Failed, Settled
from labbook.backend.numerics import Numerics
from labbook.filling.placing import place
from labbook.scene import Scene
from labbook.scene.packing import Packing


def settled(backend: Backend, closed: Scene, numerics: Numerics, below: float) -> Packing:
    """The grains of the scene `closed`, fallen as a gas of the first seed until each has less than `below` [m g d] of
    kinetic energy, on average."""
    ensemble = backend.open(backend.specialise(closed, numerics), 1)
    bed = ensemble.admit(closed, numerics, place(closed, "gas", 1), settled_below=below)
    while True:
        for event in ensemble.advance(4):
            if isinstance(event, Failed):
                raise RuntimeError(f"the bed did not settle: {event.message}")
            if isinstance(event, Settled):
                packing = ensemble.packing(bed)
                ensemble.close()
                return packing
