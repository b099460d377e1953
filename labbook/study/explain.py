"""Validation errors in the words of a study: the key as its author wrote it, what is wrong, and the remedy."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from labbook.study.absent import absent
from labbook.study.habits import habit
from labbook.study.keys import NEGLIGIBLE, Key, choices_of, find, siblings
from labbook.study.problems import instead, meant, shown
from labbook.study.source import Location, dotted

_MISSING = "this key is missing"
_TAGS = ("kind", "law", "shape")
_WRONG_UNIT = ("bad_quantity", "missing_unit", "not_a_quantity", "not_finite")
_RANGE = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")
_SIMPLE = {
    "int_type": "a whole number is needed",
    "int_from_float": "a whole number is needed",
    "int_parsing": "a whole number is needed",
    "string_type": "text is needed",
    "string_pattern_mismatch": "has characters that are not allowed",
    "string_too_long": "is too long",
    "bool_type": "true or false is needed",
    "tuple_type": "a list is needed",
    "list_type": "a list is needed",
    "too_long": "the list is too long",
    "too_short": "the list is too short",
}
_MAPPING = ("model_type", "model_attributes_type", "dict_type", "model_class_type")


_LOOKED_AT = 200
"""Errors of one section that are told: more of them repeat each other."""


@dataclass(frozen=True)
class Complaint:
    """A problem without its file: its place in the data, what is wrong, the remedy, and whether values clash."""

    location: Location
    message: str
    remedy: str
    clash: bool = False
    """Each value may be right, but not these together."""
    meant: Location | None = None
    """The key that an unknown one seems to be a misspelling of."""


def complaints(error: ValidationError, raw: Any, prefix: Location = ()) -> Iterator[Complaint]:
    """What is wrong with `raw`, the value at `prefix` of the study.

    A key that is missing because it is misspelled is told once, as the unknown key.
    """
    found: list[Complaint] = []
    for detail in error.errors(include_url=False)[:_LOOKED_AT]:
        location, discriminators = _location(detail["loc"], raw)
        beside: Any = raw
        for part in location[:-1]:
            beside = beside[part]
        beside = beside if isinstance(beside, Mapping) else {}
        found += _complain(detail, (*prefix, *location), discriminators, beside)
    misspelled = {complaint.meant for complaint in found}
    yield from (each for each in found if each.message != _MISSING or each.location not in misspelled)


def _location(loc: tuple[int | str, ...], raw: Any) -> tuple[Location, frozenset[str]]:
    """`loc` without the names of union members, and the choices (`kind: box`) that were passed on the way."""
    location: Location = ()
    chosen: set[str] = set()
    for part in loc:
        if isinstance(raw, Mapping):
            tags = {str(raw[tag]): tag for tag in _TAGS if isinstance(raw.get(tag), str)}
            if part not in raw and part in tags:
                chosen = {f"{tags[str(part)]}: {part}"}
                continue
            location, raw = (*location, part), raw.get(str(part))
        elif isinstance(raw, list) and isinstance(part, int):
            location, raw = (*location, part), raw[part] if part < len(raw) else None
    return location, frozenset(chosen)


def _complain(
    detail: Any, location: Location, chosen: frozenset[str], beside: Mapping[str, Any]
) -> Iterator[Complaint]:
    kind, context = detail["type"], detail.get("ctx", {})
    name = dotted(location)
    if kind == "impossible":
        for fault in context["faults"]:
            yield Complaint((*location, *fault.key.split(".")), fault.reason, fault.remedy, clash=True)
    elif kind == "missing":
        yield Complaint(location, _MISSING, f"add it: {_rule(name, chosen)}")
    elif kind == "extra_forbidden":
        known = siblings(name, chosen)
        if str(location[-1]).isdigit():  # 0,5 in braces is two entries
            yield Complaint(location, "unknown key", "write decimal fractions with a point, such as 0.5")
            return
        if (row := absent(name.rpartition(".")[0], str(location[-1]))) is not None:
            yield Complaint(location, row.says, row.remedy, meant=(*location[:-1], row.key) if row.key else None)
            return
        close = meant(str(location[-1]), known)
        foreign = habit(name, beside.get(str(location[-1])), known)
        if foreign is not None:
            key = tuple(foreign.key.split(".")) if foreign.key else None
            yield Complaint(
                location, "unknown key", foreign.remedy, meant=key if key and key[:-1] == location[:-1] else None
            )
            return
        elsewhere = ", ".join(choice for choice in choices_of(name) if choice not in chosen)
        message = f"this key belongs to {elsewhere}" if elsewhere else "unknown key"
        remedy = instead(str(location[-1]), known)
        yield Complaint(location, message, remedy, meant=(*location[:-1], close) if close else None)
    elif kind == "internal":
        yield Complaint(location, "a study cannot set this key", "leave it out")
    elif kind in ("union_tag_not_found", "union_tag_invalid"):
        tag = context["discriminator"].strip("'")
        inner = (*location, tag)
        choices = [choice for key in find(dotted(inner)) for choice in key.choices]
        stated, keys = str(context.get("tag", "")), detail["input"] if isinstance(detail["input"], Mapping) else ()
        if (row := absent(dotted(inner), stated)) is not None:
            yield Complaint(inner, f"{shown(stated)} is unknown: {row.says}", row.remedy)
        elif rows := [(key, row) for key in keys if (row := absent(name, str(key))) is not None]:
            yield from (Complaint((*location, str(key)), row.says, row.remedy) for key, row in rows)
        elif kind == "union_tag_not_found":
            yield Complaint(inner, _MISSING, f"add it: use one of: {', '.join(choices)}")
        else:
            yield Complaint(inner, f"{shown(stated)} is unknown", instead(stated, choices))
    elif kind == "literal_error" and (row := absent(name, str(detail["input"]))) is not None:
        yield Complaint(location, f"{shown(detail['input'])} is unknown: {row.says}", row.remedy)
    elif kind == "literal_error":
        choices = [choice for key in find(name) for choice in key.choices]
        yield Complaint(location, f"{shown(detail['input'])} is unknown", instead(str(detail["input"]), choices))
    elif kind in _MAPPING:
        yield Complaint(location, "a mapping of keys is needed", instead("", siblings(f"{name}.x")))
    elif isinstance(detail["input"], list | dict) and (row := absent(name, "[]")) is not None:
        reason = context.get("reason", "a single value is needed")
        yield Complaint(location, f"{reason}: {row.says}", f"{_rule(name, chosen)}; {row.remedy}")
    elif kind in _WRONG_UNIT:
        yield Complaint(
            location, f"{shown(detail['input'])}: {context.get('reason', 'not finite')}", _rule(name, chosen)
        )
    elif kind in _RANGE:
        bounds = _bounds(context, next((key.unit for key in find(name)), None))
        rule = _rule(name, chosen)
        unsaid = kind.startswith("less") and " in " not in rule and "at most" not in rule
        remedy = f"{rule}, and {bounds.removeprefix('it must be ')}" if unsaid else rule
        yield Complaint(location, f"{shown(detail['input'])} is out of range: {bounds}", remedy)
    else:
        yield Complaint(location, _SIMPLE.get(kind, f"{shown(detail['input'])} cannot be used"), _rule(name, chosen))


def _bounds(context: Mapping[str, Any], unit: str | None) -> str:
    """`it must be above 0 m`, for the limit that was missed."""
    words = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
    kind, limit = next((kind, float(context[kind])) for kind in words if kind in context)
    if kind == "ge" and 0 < limit <= NEGLIGIBLE:
        kind, limit = "gt", 0.0
    return f"it must be {words[kind]} {limit:g} {unit or ''}".rstrip()


def _rule(name: str, chosen: frozenset[str]) -> str:
    """What may be written at the key `name`."""
    keys: tuple[Key, ...] = tuple(key for key in find(name) if not key.of or not chosen or key.of in chosen)
    if keys:
        return keys[0].remedy
    inner = siblings(f"{name}.x")
    return f"write a mapping with the keys {', '.join(inner)}" if inner else "see docs/studies.md"
