"""Every key of a study: for checks, for remedies and for the docs."""

import re
from dataclasses import replace
from difflib import SequenceMatcher, get_close_matches
from functools import lru_cache

from labbook.numerics import Numerics
from labbook.scene.scene import Scene
from labbook.study import timestep
from labbook.study.fields import walk
from labbook.study.habits import habit
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


_FIRST = ("contact", "container", "grains", "gravity", "numerics", "walls", "fill")
"""Sections in the order in which a key that several have is meant."""


def nearest(name: str) -> str:
    """The remedy for a dotted `name` that no sweep knows: the key it seems to mean, or the few that are nearest."""
    names = [key.name for key in all_keys() if key.sweepable]
    leaf = name.rpartition(".")[2]
    inside = [known for known in names if known.startswith(f"{name}.") and known.count(".") == name.count(".") + 1]
    if inside:
        some = ", ".join(sorted(inside)[:3])
        return f"{name} is a section: name one of its keys, such as {some}"
    foreign = habit(name, None, {}, siblings(name))
    if foreign is not None and foreign.key is not None:
        return f"did you mean {foreign.key}?"
    if foreign is not None:
        return foreign.remedy
    ending = {known for known in names if known.rpartition(".")[2] == leaf}
    same = sorted(ending, key=lambda known: _FIRST.index(known.split(".")[0]))
    if same:
        others = " and ".join(known.replace("walls.*", "walls.NAME") for known in same[1:3])
        also = f" There {'are' if len(same) > 2 else 'is'} also {others}" if others else ""
        return f"did you mean {same[0]}?{also}"
    close = get_close_matches(name[:80], names, n=3, cutoff=0.6)
    leaves = {known.rpartition(".")[2]: known for known in reversed(names)}
    close += [leaves[one] for one in get_close_matches(leaf[:80], leaves, n=3, cutoff=0.7)]
    found = list(dict.fromkeys(close))[:3]
    if len(found) == 1 or (found and SequenceMatcher(None, name, found[0]).ratio() > 0.8):
        return f"did you mean {found[0]}?"
    return (
        f"the nearest are {', '.join(found)}" if found else "write a key of docs/studies.md, such as contact.friction"
    )


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
