"""A backend for tests of book-keeping: an hourglass whose grains leave one after another at seeded intervals.

It fulfils the contract to the letter (exact checkpoints, probes that change nothing, guards, members that do
not know of each other) with next to no arithmetic. In a closed container velocities decay by a tenth a step
and grains sink to half their height at rest. In an open one the lowest grain leaves at the end of an interval
drawn from a counter-based generator, seeded by the bits of the start; the mean interval follows Beverloo's
law. An outlet narrower than 3 d clogs after a third of the grains; of a backend with `clogs`, a function of D/d, every
outlet clogs after each grain with that probability.

What tests need to arrange comes from the environment, so that it reaches subprocesses: LABBOOK_TOY_DELAY [s]
per beat; LABBOOK_TOY_PAUSE [s] within every ensemble's second beat, told on standard error;
LABBOOK_TOY_COMPILES [s] that opening an ensemble takes; LABBOOK_TOY_VERSION, the cache version;
LABBOOK_TOY_DEVICES, devices beside or instead of cpu, and
LABBOOK_TOY_BREAKS, one that ends its process when an ensemble is opened there;
LABBOOK_TOY_FAILS, an orifice [mm] whose runs a guard stops at half their grains.

`Twin` is a second backend for comparisons: the same hourglass under another name, whose grains leave faster by the
part LABBOOK_TOY_BIAS, and LABBOOK_TWIN_VERSION its cache version.
"""

import hashlib
import math
import os
import sys
import time
from collections import defaultdict

import numpy as np

from labbook import backend as contract
from labbook.backend import Capabilities, Checkpoint, Emptied, Failed, Member, Settled, Spec, Status, Unsupported
from labbook.backend.probes import (
    TRACTION_SUMS,
    Above,
    Contacts,
    Crossing,
    Dissipation,
    Film,
    Ledger,
    Sample,
    Slab,
    Traction,
    Zone,
    due,
    empty_table,
)
from labbook.scene.packing import Packing

DECAY = 0.9

PAUSING = "in the middle of a long beat"


class Backend(contract.Backend):
    """The toy backend."""

    NAME, VERSION = "toy", "LABBOOK_TOY_VERSION"
    bias = 0.0

    def __init__(self, *, version=None, delay=None, fails=None, clogs=None):
        env = os.environ.get
        self.delay = float(env("LABBOOK_TOY_DELAY", "0")) if delay is None else delay
        self.fails = float(env("LABBOOK_TOY_FAILS", "0")) if fails is None else fails
        self.clogs = clogs
        self.pause = float(env("LABBOOK_TOY_PAUSE", "0"))
        self.compiles, self.opening = float(env("LABBOOK_TOY_COMPILES", "0")), 0
        self.capabilities = Capabilities(
            name=self.NAME,
            cache_version=int(env(self.VERSION, "1")) if version is None else version,
            shapes=frozenset({"sphere", "spherocylinder"}),
            laws=frozenset({"hertz-mindlin", "linear"}),
            walls=frozenset({"plane", "strip", "frustum"}),
            precisions=frozenset({"double"}),
            devices=tuple(env("LABBOOK_TOY_DEVICES", "cpu").split(",")),
            mixtures=True,
            feeds=True,
            breaks=True,
        )

    def specialise(self, scene, numerics, probes=()):
        if numerics.precision != "double":
            raise Unsupported(
                "numerics.precision", "the toy backend has no mixed; it has double: state numerics: {precision: double}"
            )
        features = (("closed", outlet_height(scene) is None), ("law", scene.contact.law), ("rods", _rods(scene)))
        return Spec(self.NAME, features, tuple(dict.fromkeys(probes)), numerics.steps_per_beat)

    def open(self, spec, slots=None, device="cpu"):
        if device not in self.capabilities.devices:
            raise Unsupported("device", f"the toy backend has no {device}")
        if device == os.environ.get("LABBOOK_TOY_BREAKS"):
            os._exit(7)
        if self.compiles:
            self.opening += 1
            time.sleep(self.compiles)
            self.opening -= 1
        return Ensemble(self, spec, slots)

    def compiling(self):
        return self.opening > 0

    def verify(self, scene, numerics, checkpoint, step):
        verified(checkpoint, scene)
        if checkpoint.arrays["count"][0] != step:
            raise ValueError(f"it is of step {checkpoint.arrays['count'][0]}, not of {step}")

    def describe(self, scene, numerics):
        e = scene.contact.restitution
        return {"restitution_asked": e, "restitution_realised": e, "damping_coefficient": 0.0}


class Twin(Backend):
    """The toy backend under another name, with grains that leave faster by the part `bias`."""

    NAME, VERSION = "twin", "LABBOOK_TWIN_VERSION"

    def __init__(self, *, bias=None, **given):
        super().__init__(**given)
        self.bias = float(os.environ.get("LABBOOK_TOY_BIAS", "0")) if bias is None else bias


def outlet_height(scene):
    return None if getattr(scene.container, "closed", False) else scene.container.outlet_plane


def _rods(scene):
    return scene.grains.shape == "spherocylinder"


class Ensemble(contract.Ensemble):
    """Members side by side."""

    def __init__(self, backend, spec, slots):
        self._backend, self._spec, self._slots = backend, spec, slots
        self.glasses, self._settling, self._rows, self._next = {}, {}, defaultdict(list), 0
        self._advanced, self._read_by = 0, {}

    def admit(self, scene, numerics, start, *, settled_below=None, settled_beats=3, probes=None):
        if self._slots is not None and len(self.glasses) >= self._slots:
            raise ValueError(f"all {self._slots} slots are taken")
        if self._backend.specialise(scene, numerics, self._spec.probes) != self._spec:
            raise ValueError("this member needs kernels that the ensemble's Spec does not have")
        member = Member(self._next)
        self._next += 1
        self.glasses[member] = Glass(self._backend, scene, numerics, start)
        self._read_by[member] = self._spec.probes if probes is None else probes
        if settled_below is not None:
            self._settling[member] = [settled_below, settled_beats, 0]
        return member

    def advance(self, beats=1):
        events = []
        self._advanced += 1
        if self._advanced == 2 and self._backend.pause:
            print(PAUSING, file=sys.stderr, flush=True)
            time.sleep(self._backend.pause)
        for member, glass in self.glasses.items():
            for _ in range(beats):
                if glass.failure or not len(glass.x):
                    break
                rows = glass.beat([probe for probe in self._read_by[member] if isinstance(probe, Film)])
                if self._backend.delay:
                    time.sleep(self._backend.delay)
                if glass.failure:
                    events.append(Failed(member, *glass.failure))
                    break
                for probe, table in glass.read(self._read_by[member], rows).items():
                    n = len(table["step"])
                    if n:
                        self._rows[probe].append({"member": np.full(n, member.index), **table})
                if not len(glass.x):
                    events.append(Emptied(member, glass.time))
                elif member in self._settling:
                    rule = self._settling[member]
                    rule[2] = rule[2] + 1 if glass.status().kinetic < rule[0] else 0
                    if rule[2] == rule[1]:
                        events.append(Settled(member, glass.time))
        return events

    def drain(self):
        rows, self._rows = self._rows, defaultdict(list)
        rods = self._spec.feature("rods")
        parts = {probe: rows[probe] or [empty_table(probe, rods)] for probe in self._spec.probes}
        return {
            probe: {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
            for probe, tables in parts.items()
        }

    def status(self, member):
        return self.glasses[member].status()

    def checkpoint(self, member):
        return self.glasses[member].checkpoint()

    def packing(self, member):
        glass = self.glasses[member]
        own = {name: getattr(glass, name).copy() for name in glass.OWN if getattr(glass, name) is not None}
        return Packing(x=glass.x.copy(), v=glass.v.copy(), omega=np.zeros_like(glass.x), **own)

    def put_back(self, member, grains):
        """They sink to half their height at once: nothing falls in an hourglass that is open."""
        glass = self.glasses[member]
        own = {"x": grains.x * (1, 1, 0.5), "v": grains.v, **{name: getattr(grains, name) for name in glass.OWN}}
        for name, more in own.items():
            if getattr(glass, name) is not None:
                setattr(glass, name, np.concatenate([getattr(glass, name), more]))

    def set_velocities(self, member, ids, v):
        """A grain that is pushed leaves, if none did before."""
        glass = self.glasses[member]
        if not np.isin(ids, glass.ids).all():
            raise ValueError("set_velocities: some of these grains are not in the scene")
        if len(ids) and not np.isfinite(glass.next[0]):
            glass.next[0] = glass.time + glass.interval(int(glass.count[1]))

    def retire(self, member):
        del self.glasses[member]
        self._settling.pop(member, None)

    def close(self):
        self.glasses.clear()


def verified(checkpoint, scene):
    """Raises ValueError for arrays that no glass of this scene can have had."""
    arrays = checkpoint.arrays
    if not set(Glass.ARRAYS) <= set(arrays) <= {*Glass.ARRAYS, *Glass.OWN}:
        raise ValueError(f"the arrays {', '.join(sorted(set(arrays) ^ set(Glass.ARRAYS)))}")
    n = len(arrays["ids"])
    shapes = {"x": (n, 3), "v": (n, 3), "ids": (n,), "count": (4,), "next": (1,)}
    kinds = {"x": "f", "v": "f", "ids": "i", "count": "i", "next": "f"}
    shapes |= {"q": (n, 4), "diameter": (n,), "kind": (n,)}
    kinds |= {"q": "f", "diameter": "f", "kind": "i"}
    for name, array in arrays.items():
        if array.shape != shapes[name] or array.dtype.kind != kinds[name]:
            raise ValueError(f"{name} has shape {array.shape} of {array.dtype}")
    if not (np.isfinite(arrays["x"]).all() and np.isfinite(arrays["v"]).all() and not np.isnan(arrays["next"]).any()):
        raise ValueError("x, v or next is no number")
    if n and not (arrays["ids"].min() >= 0 and arrays["ids"].max() < scene.grains.count):
        raise ValueError("grains that are not there")


class Glass:
    """One hourglass."""

    ARRAYS = ("x", "v", "ids", "count", "next")
    ids: np.ndarray
    q: np.ndarray | None
    OWN = ("ids", "q", "diameter", "kind")
    """What each grain is; but for its name None where all are alike."""

    def __init__(self, backend, scene, numerics, start):
        self.backend, self.scene, self.numerics = backend, scene, numerics
        self.failure = None
        if isinstance(start, Checkpoint):
            own = (backend.capabilities.name, backend.capabilities.cache_version)
            if (start.backend, start.cache_version) != own:
                raise ValueError("a checkpoint of another backend or version")
            verified(start, scene)
            for name in (*self.ARRAYS, *self.OWN):
                setattr(self, name, np.array(start.arrays[name]) if name in start.arrays else None)
            return
        for name in self.OWN:
            setattr(self, name, None if getattr(start, name) is None else getattr(start, name).copy())
        self.x, self.v = start.x.copy(), start.v.copy()
        bits = hashlib.sha256(start.x.tobytes() + start.v.tobytes()).digest()
        self.count = np.array([0, 0, int.from_bytes(bits[:6], "big"), len(self.x)])  # step, left, seed, grains
        self.next = np.array([self._interval(0)])

    @property
    def step(self):
        return int(self.count[0])

    @property
    def time(self):
        return self.step * self.numerics.dt

    def _interval(self, k):
        scene = self.scene
        if outlet_height(scene) is None:
            return math.inf
        hopper, d = scene.container, scene.grains.diameter
        orifice = getattr(hopper, "orifice", 10 * d)
        if self.backend.clogs is None and orifice < 3 * d and k >= self.count[3] // 3:
            return math.inf
        if self.backend.clogs is not None and k:
            drawn = np.random.default_rng([int(self.count[2]), k, 1]).random()
            if drawn < self.backend.clogs(orifice / d):
                return math.inf
        return self.interval(k)

    def interval(self, k):
        """Time between the k-th grain and the next, unless the outlet clogs."""
        scene, hopper, d = self.scene, self.scene.container, self.scene.grains.diameter
        orifice = getattr(hopper, "orifice", 10 * d)
        flow = 0.6 * scene.grains.density * math.sqrt(scene.gravity) * (orifice - 1.4 * d) ** 1.5
        across = getattr(hopper, "thickness", orifice - 1.4 * d)
        mean = scene.grains.mass / (flow * across) / (1 + self.backend.bias)
        return mean * np.random.default_rng([int(self.count[2]), k]).uniform(0.5, 1.5)

    def beat(self, films=()):
        """Rows of the grains that left."""
        end = self.step + self.numerics.steps_per_beat
        rows, dt = [], self.numerics.dt
        self.frames = {film: [] for film in films}
        due = [(step, film) for film in films for step in film.steps(dt, self.step + (self.step > 0), end)]
        due.sort(key=lambda frame: frame[0], reverse=True)
        if outlet_height(self.scene) is None:
            scale = DECAY ** (end - self.step)
            rest = 0.5 * self.x[:, 2]
            self.x[:, 2] = rest + (self.x[:, 2] - rest) * max(scale, 1e-3)
            self._stay_above_the_bottom()
            self.v *= scale
        before = dict(self.checkpoint().arrays)
        while self.next[0] <= end * self.numerics.dt and len(self.x):
            when = float(self.next[0])
            step = max(1, math.ceil(when / self.numerics.dt))
            while due and due[-1][0] < step:
                self._film(*due.pop())
            if self._fails():
                for name, array in before.items():
                    setattr(self, name, array)
                self.failure = (
                    "overlap",
                    step,
                    int(self.ids[0]),
                    f"grain {self.ids[0]} at step {step} overlaps by 0.3 d",
                )
                return []
            lowest = int(np.argmin(self.x[:, 2]))
            turn = () if self.q is None else self.q[lowest]
            rows.append((int(self.ids[lowest]), step, when, *self.exit_point(self.x[lowest]), *turn))
            for name in ("x", "v", *self.OWN):
                if getattr(self, name) is not None:
                    setattr(self, name, np.delete(getattr(self, name), lowest, axis=0))
            self.count[1] += 1
            self.next[0] += self._interval(int(self.count[1]))
        while due:
            self._film(*due.pop())
        self.count[0] = end
        return rows

    def _film(self, step, film):
        """Take a frame: grains stand still until they leave."""
        now, self.count[0] = self.step, step
        self.frames[film].append(self._state(film))
        self.count[0] = now

    def _stay_above_the_bottom(self):
        """Where it is inclined."""
        container = self.scene.container
        if getattr(container, "angle", math.pi / 2) > math.pi / 2 - 1e-9:
            return
        wedge = hasattr(container, "width")
        off = np.abs(self.x[:, 0] - container.eccentricity) if wedge else np.hypot(self.x[:, 0], self.x[:, 1])
        bottom = np.maximum(off - container.orifice / 2, 0) / math.tan(container.angle)
        self.x[:, 2] = np.maximum(self.x[:, 2], bottom * (1 + 1e-9))

    def exit_point(self, x):
        """x and y at which a grain leaves: as far across the outlet as it stood across the container, or where the
        nearest lid lay."""
        container = self.scene.container
        if not hasattr(container, "orifice"):
            lids = [part.shape.bounds for part in container.parts if part.opens]
            ends = [float(np.clip(x[0], lid.low[0], lid.high[0])) for lid in lids]
            return min(ends, key=lambda end: abs(end - x[0]), default=x[0]), x[1]
        if hasattr(container, "width"):
            return container.eccentricity + x[0] * container.orifice / container.width, x[1]
        return x[0] * container.orifice / container.diameter, x[1] * container.orifice / container.diameter

    def _fails(self):
        orifice = getattr(self.scene.container, "orifice", 0.0) * 1e3
        half = self.count[1] >= self.count[3] // 2
        return half and bool(self.backend.fails) and math.isclose(orifice, self.backend.fails, rel_tol=1e-9)

    def read(self, probes, left):
        beat = self.step // self.numerics.steps_per_beat
        found = {}
        for probe in probes:
            if isinstance(probe, Crossing):
                found[probe] = self._crossed(left)
            elif isinstance(probe, Film):
                frames = self.frames[probe] or [self._state(probe)]
                parts = slice(None) if self.frames[probe] else slice(0)
                found[probe] = {name: np.concatenate([one[name] for one in frames])[parts] for name in frames[0]}
            elif due(probe, beat):
                found[probe] = self._state(probe)
        return found

    def _crossed(self, left):
        rods = _rods(self.scene)
        columns = np.array(left, float).reshape(-1, 9 if rods else 5)
        zero = np.zeros(len(columns))
        table = {"id": columns[:, 0].astype(np.int64), "step": columns[:, 1].astype(np.int64), "time": columns[:, 2]}
        table |= {"x": columns[:, 3], "y": columns[:, 4], "z": zero}
        table |= {name: zero.copy() for name in ("vx", "vy", "wx", "wy", "wz")}
        table["vz"] = zero - math.sqrt(self.scene.gravity * self.scene.grains.diameter)
        return table | (dict(zip(("qw", "qx", "qy", "qz"), columns[:, 5:].T, strict=True)) if rods else {})

    def _state(self, probe):
        if isinstance(probe, Slab):
            table = self._state(Sample(fields=("x", "v")))
            inside = probe.holds(table["z"])
            return {name: column[inside] for name, column in table.items()}
        if isinstance(probe, Zone):
            table = self._state(Sample(fields=("x", "v", "q") if _rods(self.scene) else ("x", "v")))
            inside = probe.holds(np.column_stack([table[axis] for axis in "xyz"]))
            return {name: column[inside] for name, column in table.items()}
        if isinstance(probe, Contacts):
            return self._weights()
        if isinstance(probe, Traction):
            return self._bottom()
        if isinstance(probe, Ledger):
            return self._totals()
        if isinstance(probe, Above):
            n = np.array([(self.x[:, 2] > plane).sum() for plane in probe.planes])
            rows = {"plane": np.arange(len(n)), "grains": n, "mass": n * self.scene.grains.mass}
            return rows | {"step": np.full(len(n), self.step), "time": np.full(len(n), self.time)}
        if isinstance(probe, Dissipation):
            row = {
                "normal_power": 1e-3,
                "tangential_power": 3e-3,
                "wall_power": 0.0,
                "elastic": 1e-6,
                "time": self.time,
            }
            return {name: np.array([value]) for name, value in (row | {"step": self.step}).items()}
        n = len(self.x)
        table = {"id": self.ids.copy(), "step": np.full(n, self.step), "time": np.full(n, self.time)}
        for name in probe.fields:
            if name == "q" and self.q is not None:
                table |= {f"q{part}": self.q[:, c].copy() for c, part in enumerate("wxyz")}
                continue
            array = {"x": self.x, "v": self.v, "omega": np.zeros_like(self.x)}[name]
            prefix = {"x": "", "v": "v", "omega": "w"}[name]
            table |= {prefix + axis: array[:, c].copy() for c, axis in enumerate("xyz")}
        return table

    def _weights(self):
        """Every grain rests on the wall below it with its weight."""
        n, zero = len(self.x), np.zeros(len(self.x))
        table = {"i": self.ids.copy(), "j": np.full(n, -1), "wall": np.zeros(n, np.int64)}
        table |= {"step": np.full(n, self.step), "time": np.full(n, self.time)}
        weight, radius = self.scene.grains.mass * self.scene.gravity, self.scene.grains.radius
        return table | {"fx": zero, "fy": zero, "fz": zero + weight, "bx": zero, "by": zero, "bz": zero - radius}

    def _bottom(self):
        """The first wall carries the weight of all grains in its first bin."""
        n, grains = len(self.x), self.scene.grains
        row = dict.fromkeys(TRACTION_SUMS, 0.0) | {"wall": 0, "bin": 0, "contacts": n, "sliding": 0}
        row |= {"fz": n * grains.mass * self.scene.gravity, "step": self.step, "time": self.time}
        return {name: np.array([value]) for name, value in row.items()}

    def _totals(self):
        """Every grain rests with an overlap of a thousandth of d, and contacts have done no work."""
        grains, n = self.scene.grains, len(self.x)
        row = dict.fromkeys(("contact_work", "px", "py", "pz", "lx", "ly", "lz"), 0.0)
        row |= {"kinetic": 0.5 * grains.mass * float(np.sum(self.v**2)), "mass": grains.mass * n}
        row |= {"potential": grains.mass * self.scene.gravity * float(self.x[:, 2].sum())}
        row |= {"max_overlap": 1e-3 * grains.diameter, "time": self.time}
        row |= {"grains": n, "touching": n, "rebuilds": 0, "step": self.step}
        return {name: np.array([value]) for name, value in row.items()}

    def checkpoint(self):
        own = self.backend.capabilities
        names = [name for name in dict.fromkeys((*self.ARRAYS, *self.OWN)) if getattr(self, name) is not None]
        return Checkpoint(own.name, own.cache_version, {name: np.array(getattr(self, name)) for name in names})

    def status(self):
        g, d = self.scene.gravity, self.scene.grains.diameter
        kinetic = 0.5 * float(np.mean(np.sum(self.v**2, axis=1))) / (g * d) if len(self.x) else 0.0
        return Status(self.step, self.time, len(self.x), kinetic)
