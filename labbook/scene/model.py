"""The base of all scene types: frozen, strict about keys, equal when their numbers are equal; and one text for values
that are the same, with its hash, of which keys of scenes, packings and runs are made."""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar, Union

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, GetCoreSchemaHandler, ValidationInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from labbook.plugins import Registry

LENGTH = 24
"""Hexadecimal digits of a key (96 bits: a collision among 10^9 runs has a probability below 10^-11)."""


class Model(BaseModel):
    """A frozen description in SI units; an unknown key is an error."""

    # built when first used: only then are the models known that a `Choice` is among
    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True, defer_build=True
    )
    spellings: ClassVar["type[Model] | None"] = None
    """The keys that it takes beside its fields: other ways to write them."""

    if TYPE_CHECKING:

        def __hash__(self) -> int:
            """Of its values: what is frozen has one."""
            ...


_M = TypeVar("_M", bound=Model)


class Choice(Registry[type[_M]]):
    """Models of which a field takes one, by what its key `tag` says: those built in, and those of other packages.

    It marks the field: `Annotated[Base, choice]`. A model's name is the default of its field `tag`.
    """

    def __init__(self, tag: str, group: str, kind: type[_M], builtin: Iterable[type[_M]]):
        super().__init__(group, kind, builtin)
        self.tag = tag

    def __hash__(self) -> int:  # `Annotated` asks for it where a field may also be None
        return id(self)

    def _name(self, one: type[_M]) -> str:
        return str(one.model_fields[self.tag].default)

    def _made(self, loaded: Any) -> Any:
        return loaded if isinstance(loaded, type) and issubclass(loaded, self._kind) else None

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        one = Union[tuple(self.values())]  # noqa: UP007 - they are known only now
        return handler.generate_schema(Annotated[one, Field(discriminator=self.tag)])


@dataclass(frozen=True)
class Among:
    """Marks a field of text that is one of the names in `known`, which may be a registry."""

    known: Mapping[str, Any]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.literal_schema(list(self.known))


@dataclass(frozen=True)
class Fault:
    """Something that cannot be: the dotted key at fault (from the model that says so), why, the remedy."""

    key: str
    reason: str
    remedy: str


def refuse(faults: Iterable[Fault]) -> None:
    """If there are faults, raise one validation error `impossible` that carries them as `faults`."""
    found = tuple(faults)
    if found:
        text = "; ".join(f"{fault.key}: {fault.reason} ({fault.remedy})" for fault in found)
        raise PydanticCustomError("impossible", "{text}", {"text": text, "faults": found})


@dataclass(frozen=True)
class Internal:
    """Marks a field that programs set and a study file may not name."""

    def __call__(self, value: Any, info: ValidationInfo) -> Any:
        if (info.context or {}).get("units") == "required":
            raise PydanticCustomError("internal", "a study cannot set this")
        return value


_internal = Internal()
InternalFlag = Annotated[bool, _internal, BeforeValidator(_internal)]


def canonical(value: Any) -> str:
    """JSON with sorted keys, no spaces and the shortest digits that give each number back; -0.0 is 0.0.

    Raises ValueError for numbers that are not finite, TypeError for what JSON has no form for.
    """
    return json.dumps(_plain(value), sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


class Plain(dict[str, Any]):
    """What `plain` gave, which nobody changes: it is not gone through again."""


def plain(value: Mapping[str, Any]) -> Plain:
    """A mapping as JSON has it, for `canonical` and `digest`."""
    return Plain(_plain(value))


def _plain(value: Any) -> Any:
    kind = type(value)
    if kind is Plain:
        return value
    if kind is float:
        return value + 0.0
    if kind is str or kind is int or kind is bool or value is None:
        return value
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
