"""What a finished run says of itself: `run.json` in its folder."""

import json
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, TypeAdapter, field_validator, model_validator

from labbook.catalogue.parts import Measure, Part, Record, Whole
from labbook.keys import canonical
from labbook.numerics import Numerics
from labbook.probes import Contacts, Crossing, Ledger, Probe, Sample, Slab, Zone
from labbook.scene import Scene

Ending = Literal["finished", "precise", "emptied", "clogged", "diverged", "time-limit"]
Outcome = Annotated[
    Ending,
    BeforeValidator(lambda word: "time-limit" if word == "interrupted" else word),  # as older runs have it
]
"""How a discharge ended; every one of them is physics, none an error.

`finished`: the asked part was discharged. `precise`: stopped because the answer was precise enough.
`emptied`: no grain is left. `clogged`: no grain left for the stall time, a censored waiting time. `diverged`:
a guard stopped it. `time-limit`: it came to the end of `stop.max_time`.
"""


class StopRule(Part):
    """When a discharge ends."""

    discharged: float
    """Fraction of the mass that has left."""
    max_time: float
    """Time since the opening [s]."""
    stall: float
    """Time without a grain leaving [s] after which the outlet counts as clogged."""
    fill_height: float | None = None
    """Height of the bed [m] at which it has fallen far enough; None: any."""


class Coverage(Part):
    """How far a run went and what was observed: what a demand is compared with."""

    duration: Measure
    """Simulated time since the opening [s]."""
    steps: Whole
    grains: Annotated[Whole, Field(ge=1)]
    """At the opening."""
    crossed: Whole
    """Grains that left through the outlet plane."""
    last_crossing: Measure
    """When the last grain left [s]; 0 if none did."""
    stop: StopRule
    """The rule that ended it."""
    guards: dict[str, float]
    probes: tuple[str, ...]
    """Probes, as `describe_probe` writes them."""
    recording: Annotated[Measure, Field(gt=0)] | None = None
    """Time between recorded frames [s] if the run was recorded."""
    mass_left: Measure | None = None
    """Fraction of the mass that left with these grains; None where all are equal."""
    bed_height: Measure | None = None
    """Height of the settled bed at the opening [m]: twice its mean height above the outlet plane."""

    @field_validator("probes")
    @classmethod
    def _are_probes(cls, probes: tuple[str, ...]) -> tuple[str, ...]:
        for probe in probes:
            parse_probe(probe)
        return probes

    @model_validator(mode="after")
    def _belongs_together(self):
        if self.crossed > self.grains:
            raise ValueError(f"{self.crossed} of {self.grains} grains have left")
        return self

    @property
    def discharged(self) -> float:
        """Fraction of the mass that has left."""
        return self.crossed / self.grains if self.mass_left is None else self.mass_left

    @property
    def fill_height(self) -> float | None:
        """Height [m] of the bed as it is now, if its cross-section is the same everywhere."""
        return None if self.bed_height is None else self.bed_height * (1 - self.discharged)

    @property
    def waiting(self) -> float:
        """Time since the last grain left, or since the opening [s]; censored if the run clogged."""
        return self.duration - self.last_crossing


class Failure(Part):
    """Why a run diverged; its folder holds the state at the last good beat."""

    guard: str
    step: int
    grain: int
    message: str


class Observe(Part):
    """What is measured, over which fractions of the initial mass discharged."""

    measure: tuple[str, ...]
    start: float
    end: float


class RunRecord(Record):
    """All that is known of a finished run apart from its tables."""

    FILE = "run.json"
    KEY = "run_key"

    format: Literal[1] = 1
    run_key: Annotated[str, Field(pattern="^[0-9a-f]{8,64}$")]
    experiment_key: str
    scene_key: str
    packing_key: str
    lineage_key: str
    engine: str
    cache_version: Whole
    study: str
    point: Whole
    label: str
    at: dict[str, float | str]
    seed: Whole
    scene: Scene
    numerics: Numerics
    outcome: Outcome
    coverage: Coverage
    failure: Failure | None = None
    observe: Observe
    physics: dict[str, float]
    """What the engine derived: asked and realised restitution, damping coefficient."""
    device: str
    finished: str
    """When it ended (UTC, ISO 8601)."""

    @property
    def provenance(self) -> dict[str, Any]:
        """What made its last stretch: commit, versions, processor, device, threads; with seed, precision and
        speeds."""
        return {
            **self.sessions[-1].provenance,
            "engine": self.engine,
            "cache_version": self.cache_version,
            "seed": self.seed,
            "precision": self.numerics.precision,
            "device": self.device,
            "wall_time": self.wall_time,
            "process_time": self.process_time,
            "grain_steps_per_second": self.rate,
            "sessions": len(self.sessions),
        }


_KINDS: dict[str, type[Probe]] = {
    "crossing": Crossing,
    "sample": Sample,
    "slab": Slab,
    "zone": Zone,
    "contacts": Contacts,
    "ledger": Ledger,
}


def table_name(probe: Probe) -> str:
    """Name of a probe's table: `crossing`, `sample`, `slab`, `zone`, `contacts` or `ledger`."""
    return type(probe).__name__.lower()


def describe_probe(probe: Probe) -> str:
    """A probe as canonical JSON, by which coverage compares."""
    return canonical({"kind": table_name(probe), **vars(probe)})


def parse_probe(text: str) -> Probe:
    """The probe that `describe_probe` described. Raises ValueError for a text that describes none."""
    try:
        given: dict[str, Any] = json.loads(text)
        kind = _KINDS[given.pop("kind")]
        _adapter(kind).validate_python(given)  # its types; a number keeps the form that it was written in
        values: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()}
        probe = kind(**values)
        if describe_probe(probe) == text and getattr(probe, "every", 1) > 0:
            return probe
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        pass
    raise ValueError(f"no probe: {text[:80]}")


@cache
def _adapter(kind: type[Probe]) -> TypeAdapter[Probe]:
    return TypeAdapter(kind)
