"""The GPU backend with kernels that tests share, and one member of rods that it steps."""

from labbook_warp import Backend
from rods_in_silo import advanced


def sharing(device="cpu", lanes=None) -> Backend:
    """The backend; on a processor its kernels have all features in, as those of the contract's tests, which compile
    them. On a GPU they are those of users' runs."""
    return Backend(lanes=lanes, wide=device == "cpu")


def run(scene, how, start, beats, probes=(), lanes=None, device="cpu"):
    """One member, advanced: its packing and rows."""
    return advanced(sharing(device, lanes), scene, how, start, beats, probes, device)
