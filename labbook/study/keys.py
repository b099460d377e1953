"""Every key of a study: for checks, for remedies and for the docs."""

import re
from dataclasses import replace
from functools import lru_cache

from labbook.numerics import Numerics
from labbook.scene.scene import Scene
from labbook.study import timestep
from labbook.study.fields import walk
from labbook.study.key import Key
from labbook.study.schema import Fill, Settings


@lru_cache(maxsize=1)
def all_keys() -> tuple[Key, ...]:
    """All keys that models validate, in the order in which a study is best written."""
    keys = [*walk(Settings), *walk(Scene)]
    keys += [*walk(Fill, "fill."), *walk(Numerics, "numerics.")]
    steps = ", ".join(f"{step} ({law})" for law, step in timestep.DEFAULT.items())
    return tuple(replace(key, default=steps) if key.name == "numerics.dt" else key for key in keys)


def find(name: str) -> tuple[Key, ...]:
    """The keys that a dotted name (with wall names and indices filled in) may mean: one per choice it belongs to."""
    pattern = re.sub(r"\[\d+\]", "[]", name)
    wall = re.sub(r"^walls\.[^.]+", "walls.*", pattern)
    return tuple(key for key in all_keys() if key.name in (pattern, wall))


def siblings(name: str, of: frozenset[str] = frozenset()) -> tuple[str, ...]:
    """Last parts of all keys that stand next to the dotted `name`; of choices, those named in `of` (all if none)."""
    parent = re.sub(r"\[\d+\]", "[]", name.rpartition(".")[0])
    parent = re.sub(r"^walls\.[^.]+", "walls.*", parent)
    prefix = f"{parent}." if parent else ""
    names = {
        key.name.removeprefix(prefix).partition(".")[0].removesuffix("[]")
        for key in all_keys()
        if key.name.startswith(prefix) and (not key.of or not of or key.of in of)
    }
    return tuple(sorted(names - {"*", ""}))
