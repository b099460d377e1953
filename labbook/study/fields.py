"""The keys that a model validates, read off its fields."""

import math
import re
import types
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from labbook.scene.model import Internal
from labbook.scene.quantities import Unit
from labbook.study.key import ENORMOUS, NEGLIGIBLE, Key


def walk(model: type[BaseModel], prefix: str = "", of: str = "") -> Iterator[Key]:
    """The keys of `model`, their names beginning with `prefix`; `of`: the choice that all of them belong to."""
    for name, field in model.model_fields.items():
        base, metadata = _unwrap(field.annotation, list(field.metadata))
        if any(isinstance(mark, Internal) for mark in metadata):
            continue
        yield from _field(f"{prefix}{name}", field, base, metadata, of)


def _field(name: str, field: FieldInfo, base: Any, metadata: list[Any], of: str) -> Iterator[Key]:
    marks = [field.discriminator, *(mark.discriminator for mark in metadata if isinstance(mark, FieldInfo))]
    discriminator = next((mark for mark in marks if mark is not None), None)
    if discriminator is not None:
        yield from _union(name, str(discriminator), base)
    elif isinstance(base, type) and issubclass(base, BaseModel):
        yield from walk(base, f"{name}.", of)
    elif get_origin(base) is dict:
        yield from walk(get_args(base)[1], f"{name}.*.", of)
    elif get_origin(base) is tuple and get_args(base)[-1] is Ellipsis and _is_model(get_args(base)[0]):
        yield from walk(get_args(base)[0], f"{name}[].", of)
    else:
        yield _leaf(name, field, base, metadata, of)


def _union(name: str, discriminator: str, base: Any) -> Iterator[Key]:
    members = [_unwrap(member, [])[0] for member in get_args(base)]
    tags = [str(member.model_fields[discriminator].default) for member in members]
    meaning = "; ".join(f"`{t}`: {_first_line(member)}" for t, member in zip(tags, members, strict=True))
    yield Key(f"{name}.{discriminator}", "choice", choices=tuple(tags), meaning=meaning)
    shared = set.intersection(*({*member.model_fields} for member in members))
    seen = {f"{name}.{discriminator}"}
    for tag, member in zip(tags, members, strict=True):
        for key in walk(member, f"{name}.", f"{discriminator}: {tag}"):
            field = re.split(r"[.[]", key.name.removeprefix(f"{name}."))[0]
            common = field in shared and _same_everywhere(field, members)
            if key.name not in seen:
                yield replace(key, of="") if common else key
            if common or key.name == f"{name}.{discriminator}":
                seen.add(key.name)


def _same_everywhere(field: str, members: list[Any]) -> bool:
    first = members[0].model_fields[field]
    return all(
        member.model_fields[field].annotation == first.annotation
        and member.model_fields[field].description == first.description
        for member in members
    )


def _leaf(name: str, field: FieldInfo, base: Any, metadata: list[Any], of: str) -> Key:
    unit = next((mark.symbol for mark in metadata if isinstance(mark, Unit)), None)
    length = ""
    if get_origin(base) is tuple:
        parts = get_args(base)
        inner, inner_metadata = _unwrap(parts[0], [])
        unit = next((mark.symbol for mark in inner_metadata if isinstance(mark, Unit)), None)
        items = "names" if inner is str else "quantities" if unit else "numbers"
        length = f"list of {items}" if parts[-1] is Ellipsis else f"list of {len(parts)} {items}"
        base = inner
    choices = tuple(map(str, get_args(base))) if get_origin(base) is Literal else ()
    kinds = {int: "integer", str: "text", bool: "true or false", float: "quantity"}
    return Key(
        name,
        length or ("choice" if choices else kinds[base]),
        None if length and unit is None else unit,
        _limits(metadata),
        choices,
        _default(field, unit),
        " ".join((field.description or ("The only choice." if len(choices) == 1 else "")).split()),
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
    flat = [part for mark in metadata for part in (getattr(mark, "metadata", None) or [mark])]
    lows = [(float(part.gt), 1) for part in flat if isinstance(part, annotated_types.Gt)]  # pyright: ignore[reportArgumentType]
    lows += [(float(part.ge), 0) for part in flat if isinstance(part, annotated_types.Ge)]  # pyright: ignore[reportArgumentType]
    highs = [(float(part.lt), 0) for part in flat if isinstance(part, annotated_types.Lt)]  # pyright: ignore[reportArgumentType]
    highs += [(float(part.le), 1) for part in flat if isinstance(part, annotated_types.Le)]  # pyright: ignore[reportArgumentType]
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
    return isinstance(base, type) and issubclass(base, BaseModel)


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or "").strip().split("\n")[0].rstrip(".")
