"""Interface of backends.

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
from labbook.scene import BedTop, Packing, Scene


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of a backend, as data.

    Args:
        name: Name of the backend.
        cache_version: Version of its results; it increases whenever they may change.
        shapes: Shapes of grains, such as `sphere`.
        laws: Names of contact laws.
        walls: Kinds of walls.
        precisions: `double`, and `mixed` if it has it.
        devices: Aliases of the devices that it is made for, such as `cpu`.
        mixtures: Grains of one scene may differ in size and material.
        single_velocities: `mixed` keeps velocities and spins in single precision too, not only the contact law.
        feeds: Grains that left can be put back (`Ensemble.put_back`), which fed scenes need.
        breaks: Velocities of grains can be set (`Ensemble.set_velocities`), which scenes with `restart` need.
        rods_at_meshes: Rods have contacts with walls of triangles.
        moving_parts: Parts of a container can move (`Wall.moves`).
        periodic: Containers can have periodic sides (`labbook.scene.periodic`).
    """

    name: str
    cache_version: int
    shapes: frozenset[str]
    laws: frozenset[str]
    walls: frozenset[str]
    precisions: frozenset[str]
    devices: tuple[str, ...]
    mixtures: bool = False
    single_velocities: bool = False
    feeds: bool = False
    breaks: bool = False
    rods_at_meshes: bool = False
    moving_parts: bool = False
    periodic: bool = False


@dataclass(frozen=True)
class Member:
    """Handle of a running scene in an ensemble.

    Args:
        index: Number of the member; numbers are not used again.
    """

    index: int


@dataclass(frozen=True)
class Settled:
    """Event: the kinetic energy per grain stayed below `settled_below` m g d for `settled_beats` beats.

    Args:
        member: The member.
        time: End of the last of these beats [s].
    """

    member: Member
    time: float


@dataclass(frozen=True)
class Emptied:
    """Event: no grain is left.

    Args:
        member: The member.
        time: End of the beat [s].
    """

    member: Member
    time: float


@dataclass(frozen=True)
class Failed:
    """Event: a guard stopped a member, whose state is that of the last good beat.

    Args:
        member: The member.
        guard: `state` (a velocity or spin is not finite; spins may be checked once per beat only), `speed` or
            `overlap`.
        step: Step at which the guard saw it.
        grain: Id of the grain.
        message: Message for the user, with the remedy.
    """

    member: Member
    guard: str
    step: int
    grain: int
    message: str


Event = Settled | Emptied | Failed


@dataclass(frozen=True)
class Status:
    """Step, time and state of a member.

    Args:
        step: Number of steps so far.
        time: Simulated time [s].
        grains: Number of grains.
        kinetic: Kinetic energy per grain [m g d]; without gravity [m d^2/s^2].
        deepest: Largest overlap of any contact over all steps, also before a checkpoint, in diameters of the smallest
            grains (`numerics.overlap_limit`); None if unknown, as after a checkpoint without it.
        fastest: Largest speed of any grain over all steps [m/s] (`numerics.speed_limit`); for rods that of an end. None
            if unknown.
    """

    step: int
    time: float
    grains: int
    kinetic: float
    deepest: float | None = None
    fastest: float | None = None


@dataclass(frozen=True)
class Checkpoint:
    """Exact state of a member, private to the backend that made it; a run restored from it continues bit for bit.

    Args:
        backend: Name of the backend.
        cache_version: Its version of results; another one refuses the state.
        arrays: Arrays of the state by name, in the layout of the backend.
    """

    backend: str
    cache_version: int
    arrays: Mapping[str, np.ndarray] = field(repr=False)


class EndState(Protocol):
    """State of a member at its end, which no later beat changes.

    It may be computed at first access, also in another process: it can be pickled.
    """

    @property
    def checkpoint(self) -> Checkpoint:
        """Exact state."""
        ...

    @property
    def packing(self) -> Packing:
        """Portable state, in double precision."""
        ...


@dataclass(frozen=True)
class StoredState:
    """End state whose checkpoint and packing are computed already.

    Args:
        checkpoint: Exact state.
        packing: Portable state, in double precision.
    """

    checkpoint: Checkpoint
    packing: Packing


@dataclass(frozen=True)
class Spec:
    """Features of the compiled kernels; members with equal Specs share an ensemble.

    Args:
        backend: Name of the backend.
        features: Pairs of name and value, sorted by name.
        probes: Probes that are compiled in.
        steps_per_beat: Steps of a beat.
    """

    backend: str
    features: tuple[tuple[str, Any], ...]
    probes: tuple[Probe, ...] = ()
    steps_per_beat: int = 1000

    def feature(self, name: str) -> Any:
        """Return the value of a feature.

        Args:
            name: Name of the feature.

        Returns:
            Its value.

        Raises:
            KeyError: The backend has no such feature.
        """
        return dict(self.features)[name]


class Unsupported(Exception):
    """The backend cannot compute this scene or these numerics.

    Args:
        key: Key of the study at fault.
        remedy: Reason and remedy.
    """

    def __init__(self, key: str, remedy: str):
        super().__init__(f"{key}: {remedy}")
        self.key, self.remedy = key, remedy


class Overflow(Exception):
    """A buffer of fixed size is full; rows are never dropped silently."""


@dataclass(frozen=True)
class Load:
    """Cost of a grain-step on a device limited by memory bandwidth, as averages over all members.

    Args:
        listed: Near neighbours in the list of a grain.
        touching: Contacts per grain, with grains and walls.
        bytes: Bytes moved per grain-step: state, lists and springs, each read and written once.
        bandwidth: Measured copy bandwidth of the device, read and written [bytes/s].
        lanes: Threads per grain.
        rebuilds: Rebuilds of neighbour lists so far, per member.
    """

    listed: float
    touching: float
    bytes: float
    bandwidth: float
    lanes: int
    rebuilds: float


class Ensemble(ABC):
    """Base class of ensembles: running members of one Spec."""

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
        """Add a member.

        Args:
            scene: Its scene. One that needs less than the Spec has may be accepted or refused; one whose surfaces
                merely rest is accepted.
            numerics: Its numerical parameters.
            start: Its first state. A checkpoint may be of a scene that differs in the motion of surfaces
                (`fill.mobilise`).
            settled_below: Kinetic energy per grain [m g d] below which Settled is reported; None: never.
            settled_beats: Consecutive beats below it.
            probes: Probes of the Spec that read the member; None: all. Crossing and Ledger cannot be left out, since
                kernels are compiled for them.

        Returns:
            Handle of the member.

        Raises:
            ValueError: The packing has no grains, a probe is not of the Spec, or the scene needs more than the Spec
                has.
        """

    @abstractmethod
    def advance(self, beats: int = 1) -> Sequence[Event]:
        """Advance every member, except those that failed or emptied.

        Args:
            beats: Number of beats, each of `Spec.steps_per_beat` steps of the member's dt.

        Returns:
            Events of these beats.
        """

    @abstractmethod
    def drain(self) -> Mapping[Probe, Table]:
        """Return the rows since the last drain.

        Returns:
            A table for every declared probe; without rows it is empty but has its columns. A beat gives the frames of a
            Film within it and at its end, the first beat also that at step 0. A beat in which a member fails gives
            none of its frames.

        Raises:
            Overflow: Rows would be lost.
        """

    @abstractmethod
    def status(self, member: Member) -> Status:
        """Return step, time and state of a member.

        Args:
            member: The member; it may have failed or emptied.

        Returns:
            Its status after the last beat.
        """

    def progress(self, member: Member) -> Status:
        """Return the status of a member whose kinetic energy nobody reads.

        Args:
            member: The member; it may have failed or emptied.

        Returns:
            Its status after the last beat; the energy may be NaN, where computing it takes time.
        """
        return self.status(member)

    @abstractmethod
    def checkpoint(self, member: Member) -> Checkpoint:
        """Return the exact state of a member, which does not change.

        Args:
            member: The member.

        Returns:
            The state, from which `admit` continues bit for bit.
        """

    @abstractmethod
    def packing(self, member: Member) -> Packing:
        """Return the portable state of a member, which any backend can start from.

        Args:
            member: The member.

        Returns:
            Grains with their springs, in double precision and SI.
        """

    def bed(self, member: Member) -> Packing:
        """Return the grains of `packing`; springs, most of a state, need not be read for it.

        Args:
            member: The member.

        Returns:
            Grains in double precision and SI; springs may be missing.
        """
        return self.packing(member)

    def tops(self, heights: Mapping[Member, float]) -> Mapping[Member, BedTop]:
        """Return the top of each of some beds, where grains enter, and the ids of all grains.

        A backend may read those of all members at once, which are a small part of their states.

        Args:
            heights: Height z [m] by member.

        Returns:
            Grains with centres above the height of their member, and the ids of all its grains.
        """
        with self.reading(heights):
            return {member: BedTop.of(self.bed(member), height) for member, height in heights.items()}

    def end_state(self, member: Member) -> EndState:
        """Return the state of a member that ends here, copied from the device.

        Args:
            member: The member; it is advanced no more.

        Returns:
            Checkpoint and packing, which may be computed later.
        """
        return StoredState(self.checkpoint(member), self.packing(member))

    def reading(self, members: Collection[Member]) -> AbstractContextManager[None]:
        """Return a context for reading checkpoints and packings of members, none of which changes within it.

        A backend may copy at its start what all of them need. Other members may be read too.

        Args:
            members: Members that will be read.

        Returns:
            The context.
        """
        return nullcontext()

    @abstractmethod
    def put_back(self, member: Member, grains: Packing) -> None:
        """Put grains into a member, without springs: those that left, or that were absent at its start.

        They keep their ids. Their next passage of a plane is recorded like their first. Nothing else changes. The
        result depends on the grains and the beat, but not on the member's neighbours, its slot, how `advance` is split,
        or on a restart in between.

        Args:
            member: The member.
            grains: The grains with positions and velocities; sizes and kinds are as before.

        Raises:
            ValueError: A grain is in the member.
        """

    def put_back_all(self, grains: Mapping[Member, Packing]) -> None:
        """Put grains into several members; see `put_back`.

        A backend may do so at once: for each member alone, it would have to copy to and from the device.

        Args:
            grains: Grains by member.

        Raises:
            ValueError: A grain is in its member.
        """
        for member, own in grains.items():
            self.put_back(member, own)

    def set_velocities(self, member: Member, ids: np.ndarray, v: np.ndarray) -> None:
        """Set the velocities of grains of a member; all else stays, also spins and springs.

        A backend that defines it declares `Capabilities.breaks`. The result depends on the velocities and the beat, but
        not on the member's neighbours, its slot, how `advance` is split, or on a restart in between.

        Args:
            member: The member.
            ids: Ids of the grains, shape [m].
            v: Velocities [m/s] of the half step before, shape [m, 3]; the prediction for the full step is the same.

        Raises:
            NotImplementedError: The backend cannot.
            ValueError: A grain is not in the member.
        """
        raise NotImplementedError(f"{type(self).__name__} cannot set velocities")

    @abstractmethod
    def retire(self, member: Member) -> None:
        """Remove a member; its slot becomes free.

        Args:
            member: The member; its handle is invalid from now on.
        """

    @abstractmethod
    def close(self) -> None:
        """Free all resources."""

    def load(self) -> Load | None:
        """Return the present load, if memory bandwidth limits the ensemble; None: unknown."""
        return None


@dataclass(frozen=True)
class Expected:
    """Forecast for `Backend.precompile`: members of one scene, to be admitted beside others of their Spec.

    Args:
        spec: Their Spec.
        scene: Their scene.
        numerics: Their numerical parameters.
        count: Number of members.
    """

    spec: Spec
    scene: Scene
    numerics: Numerics
    count: int


@dataclass(frozen=True)
class Device:
    """Device of this machine.

    Args:
        alias: Name for the option `--device`, such as `cuda:0`.
        name: Name by its maker.
        memory: Memory of its own [bytes]; None if it has none.
    """

    alias: str
    name: str
    memory: int | None = None


@dataclass(frozen=True)
class Survey:
    """Libraries and devices of this machine that a backend uses.

    Args:
        versions: Versions of the libraries by name.
        devices: Devices on which it can run.
    """

    versions: Mapping[str, str]
    devices: tuple[Device, ...]


class Backend(ABC):
    """Base class of backends.

    Instances are cheap; compiling happens in `open` or at first use. A backend has its `capabilities` and defines
    `specialise`, `open` and `describe`. `specialise`, and all other methods that planning calls, work without the
    packages in `requires`.
    """

    requires: ClassVar[tuple[str, ...]] = ()
    """Import names of packages that it needs to run."""
    capabilities: Capabilities

    @abstractmethod
    def specialise(self, scene: Scene, numerics: Numerics, probes: Sequence[Probe] = ()) -> Spec:
        """Choose the features to compile for a scene.

        Args:
            scene: The scene.
            numerics: Its numerical parameters.
            probes: Probes to compile in.

        Returns:
            The Spec. Scenes with equal Specs share an ensemble.

        Raises:
            Unsupported: The backend cannot compute the scene; with the key and the remedy.
        """

    @abstractmethod
    def open(self, spec: Spec, slots: int | None = None, device: str = "cpu") -> Ensemble:
        """Compile the kernels of a Spec and allocate an ensemble.

        Args:
            spec: The Spec.
            slots: Number of members. A CPU admits no more, a GPU grows. None: it grows with its members.
            device: Device to run on.

        Returns:
            An ensemble without members.
        """

    @abstractmethod
    def describe(self, scene: Scene, numerics: Numerics) -> Mapping[str, float]:
        """Return derived physics of a scene for the catalogue.

        Args:
            scene: The scene.
            numerics: Its numerical parameters.

        Returns:
            `restitution_asked` and `restitution_realised`: normal restitution as stated and as the discrete steps give
            it; `damping_coefficient`: coefficient of the normal damping in the law's own definition.
        """

    def missing(self) -> tuple[str, ...]:
        """Names of packages in `requires` that are not installed; none is imported."""
        return tuple(name for name in self.requires if find_spec(name) is None)

    def precompile(self, members: Sequence[Expected], device: str) -> None:  # noqa: B027 - nothing is a choice
        """Begin to compile kernels for members that may be admitted soon, in threads of the backend.

        Does nothing for a backend that compiles later.

        Args:
            members: Members that may be admitted.
            device: Device on which they will run.
        """

    def compiling(self) -> bool:
        """True if this process is compiling kernels of the backend now; cheap, and from any thread."""
        return False

    def generated(self, spec: Spec) -> str | None:
        """Source of the generated module of kernels, for reading (docs/kernels.md).

        Args:
            spec: Spec of the kernels.

        Returns:
            The source; None if the backend generates none.
        """
        return None

    def compiled(self, spec: Spec) -> bool:
        """Look for compiled kernels in the cache of this machine.

        Args:
            spec: Spec of the kernels.

        Returns:
            True if they are there; False also if a backend cannot tell.
        """
        return False

    def bandwidth(self, device: str) -> float | None:
        """Measure the copy bandwidth of a device at present.

        Args:
            device: The device.

        Returns:
            Bytes read and written per second; None if memory is no limit.
        """
        return None

    def capacity(self, spec: Spec, scene: Scene, device: str) -> int | None:
        """Estimate the number of members that fit into the free memory of a device.

        Args:
            spec: Spec of the members.
            scene: Their scene.
            device: The device.

        Returns:
            The number, at least one; None: no limit.
        """
        return None

    def verify(  # noqa: B027 - nothing is a choice
        self, scene: Scene, numerics: Numerics, checkpoint: Checkpoint, step: int
    ) -> None:
        """Check a checkpoint, which may come from a damaged or foreign file; accepts all by default.

        `admit` raises the same before anything runs.

        Args:
            scene: Scene of the checkpoint.
            numerics: Its numerical parameters.
            checkpoint: The checkpoint.
            step: Number of steps that it should be after.

        Raises:
            ValueError: An array is missing or has another shape or type, a grain is unknown, or a position or velocity
                is not finite; with the reason.
        """

    def tractions(self, scene: Scene, numerics: Numerics, packing: Packing, probe: Traction) -> Table | None:
        """Compute the tractions on walls of a packing before any step. Nothing is compiled for it.

        Args:
            scene: Scene of the packing.
            numerics: Its numerical parameters.
            packing: The packing.
            probe: Bins of the walls.

        Returns:
            Rows of the probe with step and time 0; None, the default, if a backend cannot compute them.
        """
        return None

    def elastic_forces(
        self, scene: Scene, numerics: Numerics, packing: Packing, time: float = 0.0, *, walls: bool = True
    ) -> Table | None:  # fmt: skip
        """Compute the elastic normal forces of a packing from its overlaps. Nothing is compiled for it.

        Args:
            scene: Scene of the packing.
            numerics: Its numerical parameters.
            packing: The packing.
            time: Time since the opening [s], for parts that move.
            walls: Also compute forces at walls.

        Returns:
            Rows of the probe `Contacts`; None, the default, if a backend cannot compute them.
        """
        return None

    def survey(self) -> Survey:
        """Return versions of libraries and devices of this machine; by default the kinds in `capabilities`, unnamed."""
        return Survey({}, tuple(Device(alias, "") for alias in self.capabilities.devices))
