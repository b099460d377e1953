"""One member of rods that the GPU backend steps."""

from labbook_warp import Backend
from rods_in_silo import advanced


def run(scene, how, start, beats, probes=(), lanes=None, device="cpu"):
    """One member, advanced: its packing and rows."""
    return advanced(Backend(lanes=lanes), scene, how, start, beats, probes, device)
