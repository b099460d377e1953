"""The keys of a study: what each takes and means, read off the models that validate them."""

import ast
import inspect
import math
import re
import sys
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import SequenceMatcher, get_close_matches
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
from pydantic.fields import FieldInfo

from labbook.backend.numerics import Numerics
from labbook.campaign import Strategies
from labbook.measure import scales
from labbook.scene.contact import CONTACT_LAWS
from labbook.scene.model import Among, Internal, Model, OrWord, Required, TaggedModels
from labbook.scene.quantities import Unit
from labbook.scene.scene import Scene
from labbook.scene.timescales import WAIT
from labbook.study.absent import absent
from labbook.study.habits import habit
from labbook.study.schema import EVERY, FALLS, LONGEST, STALL, Fill, Settings

NEGLIGIBLE, ENORMOUS = 1e-3, 1e3
"""Limits of a range beyond these only keep numbers finite and are not shown as limits."""

_OF_GRAVITY = {
    "fill.max_time": LONGEST,
    "stop.max_time": LONGEST,
    "stop.stall": STALL,
    "restart.wait": WAIT,
    "record.every": EVERY,
    "window.gap": scales.GAP,
    "window.moment": scales.MOMENT,
    "window.interval": scales.INTERVAL,
}
"""Times that follow from the grains where a study does not state them, in units of sqrt(d*/g)."""
_PARTS = {
    "accuracy.flow_rate": "3 %",
    "accuracy.clogging": "20 %",
    "window.start": "20 %",
    "window.end": "60 %",
    "stop.discharged": "70 %",
}
EXAMPLES = {
    "m": "30 mm",
    "rad": "45 deg",
    "kg/m^3": "2500 kg/m^3",
    "Pa": "100 MPa",
    "": "0.5",
    "m/s^2": "9.81 m/s^2",
    "s": "10 ms",
    "N/m": "1e4 N/m",
    "Hz": "0.5 Hz",
    "m/s": "1 m/s",
    "rad/s": "1 rad/s",
    "kg/s": "50 g/s",
}


@dataclass(frozen=True)
class Key:
    """One key. `name` is dotted; `*` stands for a wall's name, `[]` for the items of a list."""

    name: str
    type: str
    """`quantity`, `integer`, `text`, `true or false`, `choice` or `list of ...`."""
    unit: str | None = None
    """SI unit of a quantity; "" for a number without unit."""
    limits: str = ""
    """Range in words, for example `in (0, 1]` or `above 0`."""
    choices: tuple[str, ...] = ()
    default: str | None = None
    """Default as a study would state it; None: the key is required."""
    meaning: str = ""
    of: str = ""
    """The choice that the key belongs to, for example `kind: box`; empty: to all."""
    within: str = ""
    """The choice that the section of that choice belongs to: `kind: primitives` of `kind: plane`; empty: to all."""

    @property
    def sweepable(self) -> bool:
        """True if a sweep may vary the key: a single value of the scene, the filling or the numerics."""
        top = self.name.split(".")[0]
        single = self.type in ("quantity", "integer", "choice", "true or false") and "[]" not in self.name
        return single and (top in Scene.model_fields or top in ("fill", "numerics"))

    @property
    def remedy(self) -> str:
        """Rule for values of the key, with an example."""
        if self.choices:
            return f"use one of: {', '.join(self.choices)}"
        within = f" {self.limits}" if self.limits else ""
        if self.type == "quantity":
            return f"write a {'quantity' if self.unit else 'number'}{within}, for example {self.example}"
        if self.type == "text":
            return f"write text ({self.meaning.rstrip('.')})"
        kind = {"integer": "a whole number", "true or false": "true or false"}.get(self.type, f"a {self.type}")
        return f"write {kind}{within}"

    @property
    def example(self) -> str:
        """A quantity of the right unit."""
        if self.name in _PARTS:
            return _PARTS[self.name]
        return EXAMPLES.get(self.unit or "", f"1 {self.unit}")


def meaning(model: type[Model], field: str) -> str:
    """Meaning of a field in words: the docstring below it, in the model or in the base that states the field.

    The source is parsed here, where a study or a page asks for keys. Pydantic would do it in every process, for each
    class (`use_attribute_docstrings`): a sixth of the time in which labbook is imported.
    """
    for kind in model.__mro__:
        if field in vars(kind).get("__annotations__", ()):
            return _docstrings(kind.__module__).get((kind.__name__, field), "")
    return ""


@lru_cache(maxsize=256)
def _docstrings(module: str) -> Mapping[tuple[str, str], str]:
    """Docstrings of the fields of a module's classes, by class and field; none where it has no source."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except (OSError, TypeError):
        return {}
    return {
        (node.name, field.target.id): " ".join(text.value.value.split())
        for node in tree.body
        if isinstance(node, ast.ClassDef)
        for field, text in pairwise(node.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant) and isinstance(text.value.value, str)
    }


def walk(model: type[Model], prefix: str = "", of: str = "") -> Iterator[Key]:
    """The keys of `model`, their names beginning with `prefix`; `of`: the choice that all of them belong to."""
    for name, field in model.model_fields.items():
        base, metadata = _unwrap(field.annotation, list(field.metadata))
        if any(isinstance(mark, Internal) for mark in metadata):
            continue
        yield from _field(f"{prefix}{name}", field, base, metadata, of, meaning(model, name))
    if model.spellings is not None:
        own = {f"{prefix}{name}" for name in model.model_fields}
        yield from (replace(key, default="none") for key in walk(model.spellings, prefix, of) if key.name not in own)


def _field(name: str, field: FieldInfo, base: Any, metadata: list[Any], of: str, meaning: str) -> Iterator[Key]:
    marks = [field.discriminator, *(mark.discriminator for mark in metadata if isinstance(mark, FieldInfo))]
    discriminator = next((mark for mark in marks if mark is not None), None)
    choice = next((mark for mark in metadata if isinstance(mark, TaggedModels)), None)
    if strategies := next((mark for mark in metadata if isinstance(mark, Strategies)), None):
        for strategy_name, strategy in strategies.items():
            yield from walk(strategy, f"{name}.{strategy_name}.", of)
    elif choice is not None:
        yield from (replace(key, within=key.within or of) for key in _union(name, choice.tag, list(choice.values())))
    elif discriminator is not None:
        members = [_unwrap(member, [])[0] for member in get_args(base)]
        yield from (replace(key, within=key.within or of) for key in _union(name, str(discriminator), members))
    elif isinstance(base, type) and issubclass(base, Model):
        yield from walk(base, f"{name}.", of)
    elif get_origin(base) is dict:
        yield from walk(get_args(base)[1], f"{name}.*.", of)
    elif get_origin(base) is tuple and get_args(base)[-1] is Ellipsis and _is_model(get_args(base)[0]):
        yield from walk(get_args(base)[0], f"{name}[].", of)
    else:
        yield _leaf(name, field, base, metadata, of, meaning)


def _union(name: str, discriminator: str, members: list[Any]) -> Iterator[Key]:
    tags = [str(member.model_fields[discriminator].default) for member in members]
    meaning = "; ".join(f"`{t}`: {_first_line(member)}" for t, member in zip(tags, members, strict=True))
    yield Key(f"{name}.{discriminator}", "choice", choices=tuple(tags), meaning=meaning)
    shared = set.intersection(*({*member.model_fields} for member in members))
    names = {f"{name}.{discriminator}"}
    for tag, member in zip(tags, members, strict=True):
        own = f"{discriminator}: {tag}"
        for key in walk(member, f"{name}.", own):
            field = re.split(r"[.[]", key.name.removeprefix(f"{name}."))[0]
            common = field in shared and _same_everywhere(field, members)
            if key.name not in names:
                yield _of_all(key, own) if common else key
            if common or key.name == f"{name}.{discriminator}":
                names.add(key.name)


def _of_all(key: Key, own: str) -> Key:
    """A key of the choice `own` that all choices have; it may belong to a choice within."""
    return replace(key, of="" if key.of == own else key.of, within="" if key.within == own else key.within)


def _same_everywhere(field: str, members: list[Any]) -> bool:
    first = members[0].model_fields[field]
    return all(
        member.model_fields[field].annotation == first.annotation
        and meaning(member, field) == meaning(members[0], field)
        for member in members
    )


def _leaf(name: str, field: FieldInfo, base: Any, metadata: list[Any], of: str, meaning: str) -> Key:
    length, word = "", next((mark for mark in metadata if isinstance(mark, OrWord)), None)
    if word is not None:
        base, metadata = _unwrap(word.number, metadata)
    unit = next((mark.symbol for mark in metadata if isinstance(mark, Unit)), None)
    if get_origin(base) is tuple:
        parts = get_args(base)
        inner, inner_metadata = _unwrap(parts[0], [])
        is_point = get_origin(inner) is tuple
        if is_point:
            inner, inner_metadata = _unwrap(get_args(inner)[0], [])
        unit = next((mark.symbol for mark in inner_metadata if isinstance(mark, Unit)), None)
        items = "points" if is_point else "names" if inner is str else "quantities" if unit else "numbers"
        length = f"list of {items}" if parts[-1] is Ellipsis else f"list of {len(parts)} {items}"
        base = inner
    choices = tuple(map(str, get_args(base))) if get_origin(base) is Literal else ()
    choices = next((tuple(mark.names) for mark in metadata if isinstance(mark, Among)), choices)
    kinds = {int: "integer", str: "text", bool: "true or false", float: "quantity"}
    return Key(
        name,
        length or ("choice" if choices else kinds[base]),
        None if length and unit is None else unit,
        (_limits(metadata) + (f" or {word.word}" if word is not None else "")).strip(),
        choices,
        None if any(isinstance(mark, Required) for mark in metadata) else _default(field, unit),
        meaning or ("Time integrator; the only choice." if len(choices) == 1 else ""),
        of,
    )


def _default(field: FieldInfo, unit: str | None) -> str | None:
    if field.is_required():
        return None
    value = field.get_default(call_default_factory=False)
    if value is None or value == () or value == "":
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        if unit == "rad":
            return f"{math.degrees(value):g} deg"
        return f"{value:.4g} {unit or ''}".strip()
    if isinstance(value, tuple):
        return f"[{', '.join(f'{item:g}' if isinstance(item, float) else str(item) for item in value)}]"
    return str(value)


def _limits(metadata: list[Any]) -> str:
    """The narrowest range that `metadata` states; limits that only keep numbers finite are left out."""
    flat = [limit for mark in metadata for limit in (getattr(mark, "metadata", None) or [mark])]
    lows = [(float(limit.gt), 1) for limit in flat if isinstance(limit, annotated_types.Gt)]  # pyright: ignore[reportArgumentType]
    lows += [(float(limit.ge), 0) for limit in flat if isinstance(limit, annotated_types.Ge)]  # pyright: ignore[reportArgumentType]
    highs = [(float(limit.lt), 0) for limit in flat if isinstance(limit, annotated_types.Lt)]  # pyright: ignore[reportArgumentType]
    highs += [(float(limit.le), 1) for limit in flat if isinstance(limit, annotated_types.Le)]  # pyright: ignore[reportArgumentType]
    low, above = max(lows, default=(-math.inf, 1))
    high, included = min(highs, default=(math.inf, 1))
    if 0 < low <= NEGLIGIBLE:
        low, above = 0.0, 1
    bounded_below, bounded_above = low > -ENORMOUS, high < ENORMOUS
    if bounded_below and bounded_above:
        return f"in {'(' if above else '['}{low:g}, {high:g}{']' if included else ')'}"
    if bounded_below:
        return f"above {low:g}" if above else f"of at least {low:g}"
    return f"of at most {high:g}" if bounded_above else ""


def _unwrap(annotation: Any, metadata: list[Any]) -> tuple[Any, list[Any]]:
    """The bare type below Annotated and `| None`, and all metadata met on the way."""
    if get_origin(annotation) is Annotated:
        base, *marks = get_args(annotation)
        return _unwrap(base, metadata + marks)
    if get_origin(annotation) in (Union, types.UnionType):
        members = [member for member in get_args(annotation) if member is not types.NoneType]
        if len(members) == 1:
            return _unwrap(members[0], metadata)
    return annotation, metadata


def _is_model(annotation: Any) -> bool:
    base, _ = _unwrap(annotation, [])
    return isinstance(base, type) and issubclass(base, Model)


def _first_line(model: type[Model]) -> str:
    return (model.__doc__ or "").strip().split("\n")[0].rstrip(".")


@lru_cache(maxsize=1)
def all_keys() -> tuple[Key, ...]:
    """All keys that models validate, in the order in which a study is best written."""
    keys = [*walk(Settings), *walk(Scene)]
    keys += [*walk(Fill, "fill."), *walk(Numerics, "numerics.")]
    laws: dict[str, list[str]] = {}
    for name, law in CONTACT_LAWS.items():
        laws.setdefault(law.usual_step, []).append(name)
    steps = ", ".join(f"{step} ({', '.join(names)})" for step, names in laws.items())
    defaults = {"numerics.dt": steps}
    defaults |= {name: f"{multiple:g} √(d*/g)" for name, multiple in _OF_GRAVITY.items()}
    defaults |= {"window.layer": f"{scales.LAYER:g} d*", "numerics.speed_limit": f"{FALLS:g} √(2 g H)"}
    defaults["fill.settled_below"] = "by fill.kind"
    defaults |= {key.name: "as in numerics" for key in keys if key.name.startswith("fill.numerics.")}
    return tuple(replace(key, default=defaults.get(key.name, key.default)) for key in keys)


@lru_cache(maxsize=1024)  # of each value of a sweep it is asked what its key takes
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
    inside = [known for known in names if known.startswith(f"{name}.") and known.count(".") == name.count(".") + 1]
    if inside:
        some = ", ".join(sorted({*inside})[:3])
        return f"{name} is a section: name one of its keys, such as {some}"
    return _from_elsewhere(name) or _of_another_section(name, names) or _resembling(name, names)


def _from_elsewhere(name: str) -> str | None:
    """The remedy for a word of another code, or of something that labbook does not have."""
    section, _, leaf = name.rpartition(".")
    if (row := absent(section, leaf)) is not None:
        return f"{row.says}: {row.remedy}"
    foreign = habit(name, None, siblings(name))
    if foreign is None:
        return None
    return foreign.remedy if foreign.key is None else f"did you mean {foreign.key}?"


def _of_another_section(name: str, names: Sequence[str]) -> str | None:
    """The remedy for the last part of a known name in the wrong section."""
    leaf = name.rpartition(".")[2]
    ending = {known for known in names if known.rpartition(".")[2] == leaf}
    homonyms = sorted(ending, key=lambda known: (_FIRST.index(known.split(".")[0]), known.count("."), known))
    if not homonyms:
        return None
    rest = " and ".join(known.replace("walls.*", "walls.NAME") for known in homonyms[1:3])
    also = f" There {'are' if len(homonyms) > 2 else 'is'} also {rest}" if rest else ""
    return f"did you mean {homonyms[0]}?{also}"


def _resembling(name: str, names: Sequence[str]) -> str:
    """The remedy for a misspelled name."""
    leaf = name.rpartition(".")[2]
    matches = get_close_matches(name[:80], names, n=3, cutoff=0.6)
    leaves = {known.rpartition(".")[2]: known for known in reversed(names)}
    matches += [leaves[near] for near in get_close_matches(leaf[:80], leaves, n=3, cutoff=0.7)]
    nearby = list(dict.fromkeys(matches))[:3]
    if not nearby:
        return "write a key of docs/studies.md, such as contact.friction"
    if len(nearby) == 1 or SequenceMatcher(None, name, nearby[0]).ratio() > 0.8:
        return f"did you mean {nearby[0]}?"
    return f"the nearest are {', '.join(nearby)}"


def choices_of(name: str) -> tuple[str, ...]:
    """The choices that a key or a section of this dotted name belongs to, each once; none of what belongs to all."""
    section = re.sub(r"\[\d+\]", "[]", name)
    inside = [key for key in all_keys() if key.name.startswith((f"{section}.", f"{section}[]."))]
    choices = [*(key.of for key in find(name)), *(key.within or key.of for key in inside)]
    return tuple(dict.fromkeys(choice for choice in choices if choice))


def siblings(name: str, of: frozenset[str] = frozenset()) -> tuple[str, ...]:
    """Last parts of all keys that stand next to the dotted `name`; of choices, those named in `of` (all if none)."""
    parent = re.sub(r"\[\d+\]", "[]", name.rpartition(".")[0])
    parent = re.sub(r"^walls\.[^.]+", "walls.*", parent)
    prefix = f"{parent}." if parent else ""
    names = set[str]()
    for key in all_keys():
        first, _, rest = key.name.removeprefix(prefix).partition(".")
        choice = (key.within or key.of) if rest else key.of
        if key.name.startswith(prefix) and (not choice or not of or choice in of):
            names.add(first.removesuffix("[]"))
    return tuple(sorted(names - {"*", ""}))
