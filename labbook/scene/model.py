"""The base of all scene types: frozen, strict about keys, equal when their numbers are equal."""

from pydantic import BaseModel, ConfigDict


class Model(BaseModel):
    """A frozen description in SI units; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
