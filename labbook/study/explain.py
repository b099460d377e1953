"""Validation errors in the words of a study: the key as its author wrote it, what is wrong, and the remedy."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from labbook.study.absent import absent
from labbook.study.habits import habit
from labbook.study.keys import NEGLIGIBLE, Key, choices_of, find, siblings
from labbook.study.problems import closest, instead, quote
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
    target: Location | None = None
    """The key that an unknown one seems to be a misspelling of."""


def complaints(error: ValidationError, raw: Any, prefix: Location = ()) -> Iterator[Complaint]:
    """Explain the errors of a value of the study.

    A misspelled key that is required is reported once, as the unknown key.

    Args:
        error: Errors of pydantic.
        raw: The value as it was read.
        prefix: Its place in the study.

    Yields:
        A complaint for each error.
    """
    all_complaints: list[Complaint] = []
    for detail in error.errors(include_url=False)[:_LOOKED_AT]:
        if detail["type"] == "default_factory_not_called":  # a default that follows from a key that is wrong
            continue
        location, discriminators = _location(detail["loc"], raw)
        beside: Any = raw
        for step in location[:-1]:
            beside = beside[step]
        beside = beside if isinstance(beside, Mapping) else {}
        all_complaints += _complain(detail, (*prefix, *location), discriminators, beside)
    misspelled = {complaint.target for complaint in all_complaints}
    yield from (each for each in all_complaints if each.message != _MISSING or each.location not in misspelled)


def _location(loc: tuple[int | str, ...], raw: Any) -> tuple[Location, frozenset[str]]:
    """`loc` without the names of union members, and the choices (`kind: box`) that were passed on the way."""
    location: Location = ()
    choices: set[str] = set()
    for step in loc:
        if isinstance(raw, Mapping):
            tags = {str(raw[tag]): tag for tag in _TAGS if isinstance(raw.get(tag), str)}
            if step not in raw and step in tags:
                choices = {f"{tags[str(step)]}: {step}"}
                continue
            location, raw = (*location, step), raw.get(str(step))
        elif isinstance(raw, list) and isinstance(step, int):
            location, raw = (*location, step), raw[step] if step < len(raw) else None
    return location, frozenset(choices)


def _complain(
    detail: Any, location: Location, choices: frozenset[str], beside: Mapping[str, Any]
) -> Iterator[Complaint]:
    """Complaints of one validation error. chosen: choices on the way (`kind: box`). beside: the keys beside it."""
    kind, context, value = detail["type"], detail.get("ctx", {}), detail["input"]
    name = dotted(location)
    if kind == "impossible":
        for fault in context["faults"]:
            target = (*location, *filter(None, fault.key.split(".")))  # of a whole section there is no key
            yield Complaint(target, fault.reason, fault.remedy, clash=True)
    elif kind == "missing":
        yield Complaint(location, _MISSING, f"add it: {_rule(name, choices)}")
    elif kind == "extra_forbidden":
        yield _unknown_key(location, choices, beside)
    elif kind == "attached":
        yield Complaint(location, context["reason"], context["remedy"])
    elif kind == "internal":
        yield Complaint(location, "a study cannot set this key", "leave it out")
    elif kind in ("union_tag_not_found", "union_tag_invalid"):
        yield from _unknown_choice(location, context, value)
    elif kind == "literal_error":
        yield _unknown_value(location, str(value))
    elif kind in _MAPPING:
        yield Complaint(location, "a mapping of keys is needed", instead("", siblings(f"{name}.x")))
    elif isinstance(value, list | dict) and (row := absent(name, "[]")) is not None:
        reason = context.get("reason", "a single value is needed")
        yield Complaint(location, f"{reason}: {row.says}", f"{_rule(name, choices)}; {row.remedy}")
    elif kind in _WRONG_UNIT:
        yield Complaint(location, f"{quote(value)}: {context.get('reason', 'not finite')}", _rule(name, choices))
    elif kind in _RANGE:
        yield _out_of_range(location, kind, context, value, _rule(name, choices))
    else:
        yield Complaint(location, _SIMPLE.get(kind, f"{quote(value)} cannot be used"), _rule(name, choices))


def _unknown_key(location: Location, choices: frozenset[str], beside: Mapping[str, Any]) -> Complaint:
    section, leaf = location[:-1], str(location[-1])
    name = dotted(location)
    names = siblings(name, choices)
    if leaf.isdigit():  # 0,5 in braces is two entries
        return Complaint(location, "unknown key", "write decimal fractions with a point, such as 0.5")
    if (row := absent(name.rpartition(".")[0], leaf)) is not None:
        return Complaint(location, row.says, row.remedy, target=(*section, row.key) if row.key else None)
    if (foreign := habit(name, beside.get(leaf), names)) is not None:
        key = tuple(foreign.key.split(".")) if foreign.key else ()
        return Complaint(location, "unknown key", foreign.remedy, target=key if key and key[:-1] == section else None)
    elsewhere = ", ".join(choice for choice in choices_of(name) if choice not in choices)
    message = f"this key belongs to {elsewhere}" if elsewhere else "unknown key"
    match = closest(leaf, names)
    return Complaint(location, message, instead(leaf, names), target=(*section, match) if match else None)


def _unknown_choice(section: Location, context: Mapping[str, Any], value: Any) -> Iterator[Complaint]:
    """Of a section without its choice (`kind`, `law`, `shape`), or with one that there is not."""
    location = (*section, context["discriminator"].strip("'"))
    tag = str(context.get("tag", ""))
    keys = value if isinstance(value, Mapping) else ()
    if absent(dotted(location), tag) is not None:
        yield _unknown_value(location, tag)
    elif rows := [(key, row) for key in keys if (row := absent(dotted(section), str(key))) is not None]:
        yield from (Complaint((*section, str(key)), row.says, row.remedy) for key, row in rows)
    elif "tag" not in context:
        yield Complaint(location, _MISSING, f"add it: use one of: {', '.join(_choices(location))}")
    else:
        yield _unknown_value(location, tag)


def _unknown_value(location: Location, word: str) -> Complaint:
    """Of a key that takes one of a few words."""
    message = f"{quote(word)} is unknown"
    if (row := absent(dotted(location), word)) is not None:
        return Complaint(location, f"{message}: {row.says}", row.remedy)
    return Complaint(location, message, instead(word, _choices(location)))


def _choices(location: Location) -> list[str]:
    return [choice for key in find(dotted(location)) for choice in key.choices]


def _out_of_range(location: Location, kind: str, context: Mapping[str, Any], value: Any, rule: str) -> Complaint:
    bounds = _bounds(context, next((key.unit for key in find(dotted(location))), None))
    unsaid = kind.startswith("less") and " in " not in rule and "at most" not in rule
    remedy = f"{rule}, and {bounds.removeprefix('it must be ')}" if unsaid else rule
    return Complaint(location, f"{quote(value)} is out of range: {bounds}", remedy)


def _bounds(context: Mapping[str, Any], unit: str | None) -> str:
    """Limit of a value that is out of range: `it must be above 0 m`."""
    words = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
    kind, limit = next((kind, float(context[kind])) for kind in words if kind in context)
    if kind == "ge" and 0 < limit <= NEGLIGIBLE:
        kind, limit = "gt", 0.0
    return f"it must be {words[kind]} {limit:g} {unit or ''}".rstrip()


def _rule(name: str, choices: frozenset[str]) -> str:
    """Rule for values of the key `name`, as a remedy."""
    keys: tuple[Key, ...] = tuple(key for key in find(name) if not key.of or not choices or key.of in choices)
    if keys:
        return keys[0].remedy
    inner = siblings(f"{name}.x")
    return f"write a mapping with the keys {', '.join(inner)}" if inner else "see docs/studies.md"
