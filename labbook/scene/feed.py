"""Feeding a silo while it flows: so that it stays as full as it is, or at a stated rate."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from labbook.scene.model import Fault, Model, refuse
from labbook.scene.stream import Stream


class Feed(Model):
    """Return of the grains that left through the outlet."""

    version: ClassVar[int] = 1
    """Part of the key of every fed run; it rises whenever a seed puts grains to other places than before."""

    kind: Literal["reinject", "rate"]
    """`reinject`: grains that left fall onto the bed again, from random free places above it. `rate`: they enter again
    by `stream`, which brings less than its rate while no grain waits or its region is full."""
    # where it is not stated it is left out of what is stored
    stream: Annotated[Stream | None, Field(exclude_if=lambda stream: stream is None)] = None
    """Stream by which grains enter again (kind: rate)."""

    @model_validator(mode="after")
    def _has_a_stream_where_one_flows(self):
        if self.kind == "rate" and self.stream is None:
            refuse([Fault("stream", "this key is missing", "state rate, low and high of the stream")])
        if self.kind != "rate" and self.stream is not None:
            refuse([Fault("stream", "grains fall onto the bed as fast as they leave", "use kind: rate")])
        if self.stream is not None and self.stream.layers:
            refuse([Fault("stream.layers", "grains enter again in random order", "leave layers out")])
        return self
