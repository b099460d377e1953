"""One text for values that are the same, and its hash: what keys of scenes, packings and runs are made of."""

import hashlib
import json
import math
from collections.abc import Mapping
from typing import Any

LENGTH = 24
"""Hexadecimal digits of a key (96 bits: a collision among 10^9 runs has a probability below 10^-11)."""


def canonical(value: Any) -> str:
    """JSON with sorted keys, no spaces and the shortest digits that give each number back; -0.0 is 0.0.

    Raises ValueError for numbers that are not finite, TypeError for what JSON has no form for.
    """
    return json.dumps(_plain(value), sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isnan(value):
        return value + 0.0
    return value


def digest(value: Any) -> str:
    """Key of anything that has a canonical JSON form."""
    return hashlib.sha256(canonical(value).encode()).hexdigest()[:LENGTH]
