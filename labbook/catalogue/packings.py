"""Packings kept in the lab: made once, shared by all runs with the same packing key."""

from pathlib import Path
from typing import Annotated, Any, Literal
from zipfile import BadZipFile

from pydantic import Field

from labbook.catalogue.parts import Record, Unreadable
from labbook.numerics import Numerics
from labbook.protocol.packing import Packing
from labbook.scene import Scene

ARRAYS = "packing.npz"


class PackingRecord(Record):
    """How a packing was made."""

    FILE = "packing.json"
    KEY = "packing_key"

    format: Literal[1] = 1
    packing_key: Annotated[str, Field(pattern="^[0-9a-f]{8,64}$")]
    closed_key: str
    engine: str
    cache_version: int
    scene: Scene
    """The closed scene, with the friction of the filling."""
    filling: dict[str, Any]
    numerics: Numerics
    grains: int
    duration: float
    """Simulated time until it was at rest [s]."""
    kinetic: float
    """Kinetic energy per grain at the end [m g d]."""


def load_packing(folder: Path) -> Packing:
    """The packing in `folder`. Raises Unreadable."""
    try:
        return Packing.load(folder / ARRAYS)
    except (OSError, ValueError, TypeError, KeyError, EOFError, BadZipFile) as error:
        raise Unreadable(f"{folder / ARRAYS}: not a packing ({type(error).__name__}: {error})") from error
