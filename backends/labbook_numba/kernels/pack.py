"""Squeezing those of eight near contacts that touch into a block."""

from labbook_dem.words import FRICTION, func

from labbook_numba.kernels.blocks import DEPTH, HELD
from labbook_numba.kernels.features import STRIDE
from labbook_numba.lanes import eight_at
from labbook_numba.squeeze import exchange, squeeze, squeeze_places


@func
def eights_at(near, place):
    """Eight vectors, from columns of State.near."""
    return eight_at(near, place), eight_at(near, place + STRIDE), eight_at(near, place + STRIDE + STRIDE)


@func
def squeeze_vectors(b, place, vectors, touching):
    """Write the picked of eight vectors to columns of the block."""
    x, y, z = vectors
    squeeze(b, place, x, touching)
    squeeze(b, place + STRIDE, y, touching)
    squeeze(b, place + STRIDE + STRIDE, z, touching)


@func
def squeeze_entries(b, slot, count, depth, held, k, touching, here):
    """Write `depth` of the picked of the list entries k..k + 8, whether they hold springs, and which entries they are.

    depth: what goes to DEPTH.

    From now on those that touch hold one; `here`: those of the eight that are in the list.
    """
    squeeze(b, DEPTH + count, depth, touching)
    if FRICTION:
        squeeze(b, HELD + count, exchange(held, k, touching, here), touching)
        squeeze_places(slot, count, k, touching)
