"""The base of all scene types: frozen, strict about keys, equal when their numbers are equal."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationInfo
from pydantic_core import PydanticCustomError


class Model(BaseModel):
    """A frozen description in SI units; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)


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
            raise PydanticCustomError("internal", "this is not for a study to set")
        return value


_internal = Internal()
InternalFlag = Annotated[bool, _internal, BeforeValidator(_internal)]
