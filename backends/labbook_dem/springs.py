"""Finding the springs of a packing in the lists of a backend."""

import numpy as np


def places(ascending: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Where each wanted key stands in an ascending array; -1 if nowhere."""
    if not len(ascending):
        return np.full(len(wanted), -1)
    at = np.searchsorted(ascending, wanted).clip(max=len(ascending) - 1)
    return np.where(ascending[at] == wanted, at, -1)
