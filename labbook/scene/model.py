"""Base of all scene types: frozen, strict about keys, equal when their numbers are equal.

Canonical JSON is the same text for equal values; keys of scenes, packings and runs are its hash.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache, wraps
from json.encoder import encode_basestring_ascii
from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, ParamSpec, Self, TypeVar, Union

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, GetCoreSchemaHandler, ValidationInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from labbook.plugins import Registry

LENGTH = 24
"""Hexadecimal digits of a key (96 bits: a collision among 10^9 runs has a probability below 10^-11)."""


_set = object.__setattr__  # of what is frozen


class Model(BaseModel):
    """Frozen description in SI units; an unknown key is an error."""

    # built when first used: only then are the models known that a `TaggedModels` is among
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)
    spellings: ClassVar["type[Model] | None"] = None
    """Keys that it takes beside its fields: other ways to write them."""

    if TYPE_CHECKING:

        def __hash__(self) -> int:
            """Hash of the values, as the model is frozen."""
            ...

    @classmethod
    def of(cls, **values: Any) -> Self:
        """Make a model of validated values without a check, in a tenth of the time.

        Args:
            values: All fields, in SI units and of the types that validation gives.

        Returns:
            The model.
        """
        model = cls.__new__(cls)
        _set(model, "__dict__", values)
        _set(model, "__pydantic_fields_set__", set(values))
        _set(model, "__pydantic_extra__", None)
        _set(model, "__pydantic_private__", None)
        return model


_M = TypeVar("_M", bound=Model)
_P = ParamSpec("_P")
_R = TypeVar("_R")


class TaggedModels(Registry[type[_M]]):
    """Registry of models of which a field takes one, by the value of its key `tag`.

    It marks the field: `Annotated[Base, choice]`. A model's name is the default of its field `tag`.
    """

    def __init__(self, tag: str, group: str, kind: type[_M], builtin: Iterable[type[_M]]):
        super().__init__(group, kind, builtin)
        self.tag = tag

    def __hash__(self) -> int:  # `Annotated` asks for it where a field may also be None
        return id(self)

    def _name(self, one: type[_M]) -> str:
        return str(one.model_fields[self.tag].default)

    def _object_of(self, loaded: Any) -> Any:
        return loaded if isinstance(loaded, type) and issubclass(loaded, self._kind) else None

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        union = Union[tuple(self.values())]  # noqa: UP007 - they are known only now
        return handler.generate_schema(Annotated[union, Field(discriminator=self.tag)])


@dataclass(frozen=True)
class Among:
    """Mark of a text field that takes one of `names`, which may be a registry."""

    names: Mapping[str, Any]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.literal_schema(list(self.names))


@dataclass(frozen=True)
class OrWord:
    """Mark of a field of a type `number` in whose place a `word` may stand."""

    number: Any
    word: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        def check(value: Any, number: Callable[[Any], Any]) -> Any:
            return value if value == self.word else number(value)

        # written as it is: the schema of the number would warn of a word
        serialization = core_schema.plain_serializer_function_ser_schema(lambda value: value)
        return core_schema.no_info_wrap_validator_function(
            check, handler.generate_schema(self.number), serialization=serialization
        )


@dataclass(frozen=True)
class Fault:
    """Contradiction in a study.

    Attributes:
        key: Dotted key at fault, from the model that reports it.
        reason: Reason, as part of a sentence.
        remedy: Remedy, as an imperative.
    """

    key: str
    reason: str
    remedy: str


def refuse(faults: Iterable[Fault]) -> None:
    """Refuse a model that has faults.

    Args:
        faults: Faults; none if the model is possible.

    Raises:
        PydanticCustomError: There are faults; its type is `impossible`, and its context has them as `faults`.
    """
    refused = tuple(faults)
    if refused:
        text = "; ".join(f"{fault.key}: {fault.reason} ({fault.remedy})" for fault in refused)
        raise PydanticCustomError("impossible", "{text}", {"text": text, "faults": refused})


@dataclass(frozen=True)
class Internal:
    """Mark of a field that programs set and a study file may not name."""

    def __call__(self, value: Any, info: ValidationInfo) -> Any:
        if (info.context or {}).get("units") == "required":
            raise PydanticCustomError("internal", "a study cannot set this")
        return value


_internal = Internal()
InternalFlag = Annotated[bool, _internal, BeforeValidator(_internal)]


@dataclass(frozen=True)
class Required:
    """Mark of a field with a default in Python that a study has to state."""


def once(size: int) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Decorate a function of frozen values to compute each result once.

    Values of another package may have no hash; their results are computed at each call.

    Args:
        size: Number of results that are kept, the latest.

    Returns:
        The decorator.
    """

    def decorate(work: Callable[_P, _R]) -> Callable[_P, _R]:
        memo = lru_cache(maxsize=size)(work)

        @wraps(work)
        def cached(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            try:
                return memo(*args, **kwargs)  # pyright: ignore[reportArgumentType]
            except TypeError:
                return work(*args, **kwargs)

        return cached

    return decorate


class Text(str):
    """Canonical JSON of a part that many values have in common: `canonical` takes it as it stands."""

    __slots__ = ()


def canonical(value: Any) -> Text:
    """Write canonical JSON: sorted keys, no spaces and the shortest digits that give each number back; -0.0 is 0.0.

    Args:
        value: Numbers, texts, booleans, None, and mappings, lists and tuples of these.

    Returns:
        The JSON, the same for equal values.

    Raises:
        ValueError: A number is not finite.
        TypeError: JSON has no form for a value.
    """
    return Text(_json_text(value))


def _json_text(value: Any) -> str:
    kind = type(value)
    if kind is Text:
        return value
    if kind is float or isinstance(value, float):
        if not isfinite(value):
            raise ValueError(f"JSON has no form for {value}")
        return _digits(value + 0.0)
    if kind is str:
        return encode_basestring_ascii(value)
    if kind is int:
        return repr(value)
    if kind is dict or isinstance(value, Mapping):
        return f"{{{','.join([_name(key) + _json_text(value[key]) for key in sorted(value, key=str)])}}}"
    if kind is tuple or isinstance(value, list | tuple):
        return f"[{','.join([_json_text(item) for item in value])}]"
    return json.dumps(value)


_digits = float.__repr__  # of NumPy's numbers too, which are floats


@lru_cache(maxsize=1024, typed=True)
def _name(key: Any) -> str:
    return f"{encode_basestring_ascii(str(key))}:"


def digest(value: Any) -> str:
    """Compute the key of a value.

    Args:
        value: Value with a canonical JSON form.

    Returns:
        First hexadecimal digits of the SHA-256 of that form.
    """
    return hashlib.sha256(canonical(value).encode()).hexdigest()[:LENGTH]
