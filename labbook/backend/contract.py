"""The interface of a backend.

A backend runs *ensembles*: many members of one specialisation, each with its own parameters, clock and time step.
Backends know no phases: a filling is a closed scene that starts from a gas, a discharge is the open scene that starts
from its packing. The result of a member depends, bit for bit, only on its scene, numerics, start and Spec: not on other
members, its slot, or how `advance` is split.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, ClassVar, Protocol

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe, Table, Traction
from labbook.scene import Scene
from labbook.scene.packing import Packing


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of a backend, as data. `cache_version` increases whenever its results may change."""

    name: str
    cache_version: int
    shapes: frozenset[str]
    laws: frozenset[str]
    walls: frozenset[str]
    precisions: frozenset[str]
    devices: tuple[str, ...]
    mixtures: bool = False
    """Whether grains of one scene may differ in size and material."""
    single_velocities: bool = False
    """Whether `mixed` keeps velocities and spins in single precision too, and not the contact law only."""
    feeds: bool = False
    """Whether grains that left can be put back (`Ensemble.put_back`), which fed scenes need."""
    breaks: bool = False
    """True if velocities of grains can be set (`Ensemble.set_velocities`), which scenes with `restart` need."""
    rods_at_meshes: bool = False
    """True if rods have contacts with walls of triangles."""
    moving_parts: bool = False
    """True if parts of a container can move (`Wall.moves`)."""


@dataclass(frozen=True)
class Member:
    """A handle on one running scene of an ensemble."""

    index: int


@dataclass(frozen=True)
class Settled:
    """Kinetic energy per grain stayed below `settled_below` m g d for `settled_beats` beats."""

    member: Member
    time: float


@dataclass(frozen=True)
class Emptied:
    """No grain is left."""

    member: Member
    time: float


@dataclass(frozen=True)
class Failed:
    """A guard stopped a member; its state is that of the last good beat. `guard`: state (a velocity or spin that is no
    number; spins may be checked once per beat), speed, overlap."""

    member: Member
    guard: str
    step: int
    grain: int
    message: str


Event = Settled | Emptied | Failed


@dataclass(frozen=True)
class Status:
    """Step, time and state of a member; kinetic energy per grain is in units of m g d (m d^2/s^2 without gravity).

    `deepest` and `fastest` are over all steps so far, also before a checkpoint; None if not known, as after a
    checkpoint without them.
    """

    step: int
    time: float
    grains: int
    kinetic: float
    deepest: float | None = None
    """Largest overlap of any contact, in diameters of the smallest grains, as `numerics.overlap_limit` counts it."""
    fastest: float | None = None
    """Largest speed of any grain [m/s], as `numerics.speed_limit` counts it: of rods that of an end."""


@dataclass(frozen=True)
class Checkpoint:
    """The exact state of a member, private to the backend that made it. Restoring it continues bit for bit."""

    backend: str
    cache_version: int
    arrays: Mapping[str, np.ndarray] = field(repr=False)


class EndState(Protocol):
    """The state of a member, which no later beat changes. It may be worked out when it is first asked for, also in
    another process: it can be pickled."""

    @property
    def checkpoint(self) -> Checkpoint:
        """The exact state."""
        ...

    @property
    def packing(self) -> Packing:
        """The portable state, in double precision."""
        ...


@dataclass(frozen=True)
class StoredState:
    """An end state that is worked out already."""

    checkpoint: Checkpoint
    packing: Packing


@dataclass(frozen=True)
class Spec:
    """Features of the compiled kernels. Members with equal Specs share an ensemble."""

    backend: str
    features: tuple[tuple[str, Any], ...]
    probes: tuple[Probe, ...] = ()
    steps_per_beat: int = 1000

    def feature(self, name: str) -> Any:
        """The value of one feature."""
        return dict(self.features)[name]


class Unsupported(Exception):
    """The backend cannot compute this scene or these numerics. `key`: key of the study; `remedy`: reason and remedy."""

    def __init__(self, key: str, remedy: str):
        super().__init__(f"{key}: {remedy}")
        self.key, self.remedy = key, remedy


class Overflow(Exception):
    """A buffer of fixed size is full. No row is dropped silently."""


@dataclass(frozen=True)
class Load:
    """Cost of a grain-step on a device limited by memory bandwidth; averages over all members."""

    listed: float
    """Near neighbours listed per grain."""
    touching: float
    """Contacts per grain, with grains and walls."""
    bytes: float
    """Bytes moved per grain-step: state, lists and springs, each read and written once."""
    bandwidth: float
    """Measured copy bandwidth of the device, read and written [bytes/s]."""
    lanes: int
    """Threads per grain."""
    rebuilds: float
    """Rebuilds of neighbour lists so far, per member."""


class Ensemble(ABC):
    """Running members of one Spec."""

    @abstractmethod
    def admit(
        self,
        scene: Scene,
        numerics: Numerics,
        start: Packing | Checkpoint,
        *,
        settled_below: float | None = None,
        settled_beats: int = 3,
        probes: Sequence[Probe] | None = None,
    ) -> Member:
        """Add a member. `settled_below`: report Settled below this kinetic energy per grain [m g d]. `probes`: those
        of the Spec that read it; None: all. Crossing and Ledger, for which kernels are compiled, cannot be
        left out. A checkpoint may be of a scene that differs in the motion of surfaces (`fill.mobilise`).

        Raises ValueError for a packing without grains, for other probes, and for a scene that needs more than the Spec
        has. A scene that needs less may be accepted or refused; one whose surfaces merely rest is accepted."""

    @abstractmethod
    def advance(self, beats: int = 1) -> Sequence[Event]:
        """Advance every member by `beats` x steps_per_beat steps of its dt, except members that failed or emptied."""

    @abstractmethod
    def drain(self) -> Mapping[Probe, Table]:
        """Rows since the last drain, for every declared probe; a probe without rows gives an empty table with its
        columns. A beat gives the frames of a Film that lie within it and at its end, the first beat also that at step
        0; a beat in which a member fails gives none of it. Raises Overflow if rows would be lost."""

    @abstractmethod
    def status(self, member: Member) -> Status:
        """Step, time and state of a member."""

    @abstractmethod
    def checkpoint(self, member: Member) -> Checkpoint:
        """The exact state; the member does not change."""

    @abstractmethod
    def packing(self, member: Member) -> Packing:
        """The portable state, in double precision."""

    def bed(self, member: Member) -> Packing:
        """Return the grains of `packing`, for which springs need not be read: they are most of a state."""
        return self.packing(member)

    def end_state(self, member: Member) -> EndState:
        """Return the state of a member that ends here, copied from the device."""
        return StoredState(self.checkpoint(member), self.packing(member))

    def reading(self, members: Collection[Member]) -> AbstractContextManager[None]:
        """Return a context for reading checkpoints and packings of these members, of which none changes within it.

        A backend may copy what it needs of all of them at once. Others may be read too.
        """
        return nullcontext()

    @abstractmethod
    def put_back(self, member: Member, grains: Packing) -> None:
        """Put grains that left back into a member, or such that were not there at its start, with positions and
        velocities from `grains`, without springs.

        They keep their ids, and must have the same size and kind as before. Their next passage of a plane is recorded
        as their first was. Nothing else changes, and the result depends on what was put back after which
        beat, but not on its neighbours, its slot, how `advance` is split, or whether it was restored meanwhile.
        Raises ValueError for grains that are there."""

    def put_back_all(self, grains: Mapping[Member, Packing]) -> None:
        """Put grains that left back into several members, as `put_back` does into each.

        A backend may do so at once, where each member alone costs copies to and from a device.
        """
        for member, own in grains.items():
            self.put_back(member, own)

    def set_velocities(self, member: Member, ids: np.ndarray, v: np.ndarray) -> None:
        """Give grains of a member other velocities; all else stays, their spins and springs too.

        A backend that defines it says so (`Capabilities.breaks`). The result depends on the beat after which velocities
        were set, but not on its neighbours, its slot, how `advance` is split, or whether it was restored meanwhile.

        Args:
            member: The member.
            ids: Of the grains, shape [m].
            v: Velocities [m/s] of the half step before, shape [m, 3]; they are also what is predicted for now.

        Raises:
            NotImplementedError: The backend cannot.
            ValueError: A grain is not there.
        """
        raise NotImplementedError(f"{type(self).__name__} cannot set velocities")

    @abstractmethod
    def retire(self, member: Member) -> None:
        """Drop a member; its slot is free."""

    @abstractmethod
    def close(self) -> None:
        """Free all resources."""

    def load(self) -> Load | None:
        """The present load, from an ensemble whose speed memory limits; None: not known."""
        return None


@dataclass(frozen=True)
class Expected:
    """Members of one scene that are about to be admitted: `count` of them, beside others of their Spec."""

    spec: Spec
    scene: Scene
    numerics: Numerics
    count: int


@dataclass(frozen=True)
class Device:
    """A device that a backend finds on this machine. `memory`: bytes of its own memory, if any."""

    alias: str
    name: str
    memory: int | None = None


@dataclass(frozen=True)
class Survey:
    """Versions of the libraries that a backend uses, by name, and the devices that it finds on this machine."""

    versions: Mapping[str, str]
    devices: tuple[Device, ...]


class Backend(ABC):
    """The base class of backends. Instances are cheap; compiling happens in `open` or at first use.

    A backend has its `capabilities` and defines `specialise`, `open` and `describe`. `specialise` and all else that a
    plan asks for work without the packages in `requires`.
    """

    requires: ClassVar[tuple[str, ...]] = ()
    """Packages, by the names under which they are imported, without which it cannot run."""
    capabilities: Capabilities

    @abstractmethod
    def specialise(self, scene: Scene, numerics: Numerics, probes: Sequence[Probe] = ()) -> Spec:
        """Features compiled in. Raises Unsupported(key, remedy)."""

    @abstractmethod
    def open(self, spec: Spec, slots: int | None = None, device: str = "cpu") -> Ensemble:
        """Prepare and allocate for `slots` members: on a CPU no more are admitted, on a GPU it grows for more. None: it
        grows with its members."""

    @abstractmethod
    def describe(self, scene: Scene, numerics: Numerics) -> Mapping[str, float]:
        """Derived physics for the catalogue: restitution_asked, restitution_realised, damping_coefficient."""

    def missing(self) -> tuple[str, ...]:
        """Those of the packages in `requires` that are not installed. None is imported."""
        return tuple(name for name in self.requires if find_spec(name) is None)

    def precompile(self, members: Sequence[Expected], device: str) -> None:  # noqa: B027 - nothing is a choice
        """Begin to compile, in threads of its own, what these members will need. They may never come. Does nothing for
        a backend that compiles later."""

    def compiling(self) -> bool:
        """Whether this process is compiling kernels of the backend now; cheap, and from any thread."""
        return False

    def generated(self, spec: Spec) -> str | None:
        """Source of the module of kernels of a Spec, for reading (docs/kernels.md); None: there is none."""
        return None

    def compiled(self, spec: Spec) -> bool:
        """Tell if compiled kernels of a Spec are cached on this machine; False where a backend cannot tell."""
        return False

    def bandwidth(self, device: str) -> float | None:
        """Measure the copy bandwidth of a device at present, read and written [bytes/s]; None: memory is no limit."""
        return None

    def capacity(self, spec: Spec, scene: Scene, device: str) -> int | None:
        """How many members of `scene` fit into the memory that is free now, at least one; None: any number."""
        return None

    def verify(  # noqa: B027 - nothing is a choice
        self, scene: Scene, numerics: Numerics, checkpoint: Checkpoint, step: int
    ) -> None:
        """Check a checkpoint, which may come from a damaged or foreign file. Accepts all where it is not defined.

        Raises ValueError, with the reason, for a checkpoint that is not of this scene after `step` steps: arrays that
        are missing or have other shapes or types, unknown grains, positions or velocities that are not finite. `admit`
        raises the same before anything runs.
        """

    def tractions(self, scene: Scene, numerics: Numerics, packing: Packing, probe: Traction) -> Table | None:
        """Rows of `probe` for a packing in `scene`, before any step, with the step and time 0.

        None, the default, where a backend cannot tell. Nothing is compiled for it.
        """
        return None

    def elastic_forces(self, scene: Scene, numerics: Numerics, packing: Packing, time: float = 0.0) -> Table | None:
        """Rows of the probe `Contacts` with the elastic normal forces of a packing, as its grains overlap.

        time: since the opening [s], for parts that move. None, the default, where a backend cannot tell. Nothing is
        compiled for it.
        """
        return None

    def survey(self) -> Survey:
        """Versions of libraries, and the devices of this machine; here those in `capabilities`, of unknown names."""
        return Survey({}, tuple(Device(alias, "") for alias in self.capabilities.devices))
