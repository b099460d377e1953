"""One discharge of the scene of gpu.py by peclet or DEM-Engine, in an interpreter that has the code; gpu.py calls it.

    python benchmarks/peers/gpu_peers.py peclet bed.npz 10000

It needs NumPy and the code only. It prints one line of JSON for the start, and one for each timing as soon as it has
ended. So what was measured is known even if the process is stopped.
"""

import argparse
import itertools
import json
import math
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np

DIAMETER, DENSITY = 3e-3, 2500.0  # m, kg/m^3
SHEAR_MODULUS, POISSON_RATIO = 1e7, 0.25  # Pa
FRICTION, RESTITUTION, GRAVITY = 0.5, 0.3, 9.81
DT = 5e-6  # s
FIRST_BED = 10_000
"""Grains of the smallest box. Larger boxes hold copies of its bed, side by side."""
RELAX = 4000
"""Steps of a bed in the closed box before the opening: codes differ in law and walls."""
STEPS = 10_000
"""Steps of one timing: 0.05 s. The first timing begins 0.05 s after the opening."""
SAFETY = 0.5
"""Speed [m/s] beyond the current ones that DEM-Engine foresees in its contact detection; its own default is 3."""
SKINS = (0.3, 0.15, 0.6, 1.0)
"""Skins of peclet's lists [grain radii]. The first is its default."""


@dataclass(frozen=True)
class Size:
    """Box with a slot over its whole depth: width, depth and slot [d], and copies of the first bed in x and y."""

    width: float
    depth: float
    slot: float
    copies: tuple[int, int]

    @property
    def metres(self) -> tuple[float, float, float]:
        """Width, depth and slot [m]."""
        return self.width * DIAMETER, self.depth * DIAMETER, self.slot * DIAMETER


SIZES = {FIRST_BED: Size(20, 10, 8, (1, 1)), 100_000: Size(100, 20, 8, (5, 2)), 1_000_000: Size(200, 100, 12, (10, 10))}
"""Boxes by their number of grains. All beds are some 44 d high."""


def side_by_side(bed: np.ndarray, size: Size) -> np.ndarray:
    """Centres [m], shape [n, 3], of the grains of a box: copies of the first bed."""
    width, depth, _ = SIZES[FIRST_BED].metres
    shifts = [
        ((i - (size.copies[0] - 1) / 2) * width, (j - (size.copies[1] - 1) / 2) * depth, 0.0)
        for i, j in itertools.product(*map(range, size.copies))
    ]
    return np.concatenate([bed + np.array(shift) for shift in shifts])


class Code(Protocol):
    """A peer with a bed in the closed box."""

    version: str
    """Of the code."""
    skin: float | None
    """Of its lists [grain radii], if it may be chosen."""

    def advance(self, steps: int) -> None:
        """Take steps, and wait for their end."""
        ...

    def positions(self) -> np.ndarray:
        """Centres of all grains [m], shape [n, 3]. Grains that have left fall on below z = 0."""
        ...

    def open(self) -> None:
        """Open the slot."""
        ...


class Peclet:
    """peclet.dem: explicit Hertz-Mindlin steps in single precision.

    Walls are grids of signed distances, which are exact for planes. Its analytic walls let grains through here
    (version 1.1.0). A grid cannot be moved, so the opening is a second simulation with the slotted floor. Friction
    springs begin anew there.
    """

    CALL = 1000
    """Steps of one call."""

    def __init__(self, size: Size, x: np.ndarray):
        self._dem: Any = import_module("peclet.dem")
        self._size = size
        self._count = len(x)
        self._top = float(x[:, 2].max())
        self.version = f"{self._dem.__version__} ({self._dem.execution_space})"
        self.skin: float | None = SKINS[0]
        still = np.zeros_like(x)
        self._simulation = self._make(x, still, still, _plane(lambda x, y, z: z, (1.0, 1.0, 1.0)))

    def _make(self, x: np.ndarray, v: np.ndarray, omega: np.ndarray, floor: tuple) -> Any:
        width, depth, _ = self._size.metres
        radius = DIAMETER / 2
        mass = DENSITY * math.pi / 6 * DIAMETER**3
        simulation = self._dem.Simulation(capacity=self._count)
        simulation.initialize_shape("sphere", radius)
        simulation.set_global_scale(1.0)
        extent = (2 * width, 2 * depth, self._top + 2.0)
        simulation.set_domain(extent=extent, origin=(-width, -depth, -1.5), periodic=(False, False, False))
        simulation.set_positions(np.ascontiguousarray(x, np.float32))
        simulation.set_inv_mass(np.full(self._count, 1 / mass, np.float32))
        simulation.set_inv_inertia(np.full((self._count, 3), 1 / (0.4 * mass * radius**2), np.float32))
        simulation.set_velocities(np.ascontiguousarray(v, np.float32))
        simulation.set_angular_velocities(np.ascontiguousarray(omega, np.float32))
        simulation.set_gravity((0, 0, -GRAVITY))
        simulation.set_material_params(RESTITUTION, 0.0, FRICTION)
        simulation.set_hertz_material(0, 2 * SHEAR_MODULUS * (1 + POISSON_RATIO), POISSON_RATIO)
        simulation.set_dt(DT)
        sides = _plane(lambda x, y, z: width / 2 - abs(x), (width / 2, 1.0, 1.0))
        faces = _plane(lambda x, y, z: depth / 2 - abs(y), (1.0, depth / 2, 1.0))
        for grid in (sides, faces, floor):
            simulation.add_sdf_wall(*grid, RESTITUTION, FRICTION)
        return simulation

    def advance(self, steps: int) -> None:
        for done in range(0, steps, self.CALL):
            self._simulation.step_hertz(min(self.CALL, steps - done), self.skin)

    def positions(self) -> np.ndarray:
        return self._read("positions")

    def _read(self, field: str) -> np.ndarray:
        return np.asarray(getattr(self._simulation, f"get_{field}")(), float).reshape(-1, 3)

    def open(self) -> None:
        x, v, omega = (self._read(field) for field in ("positions", "velocities", "angular_velocities"))
        del self._simulation  # its memory is free before the other is made
        self._simulation = self._make(x, v, omega, _slotted_floor(self._size, self._top))


def _plane(distance: Callable[..., np.ndarray], spacing: tuple[float, float, float]) -> tuple:
    """Grid of a distance that is linear within its cells: values, origin and spacing [m]."""
    axes = [np.arange(-2, 3) * step for step in spacing]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    values = distance(x, y, z)
    return np.asfortranarray(values, np.float32), tuple(float(axis[0]) for axis in axes), spacing


def _slotted_floor(size: Size, top: float, spacing: float = 5e-4, thick: float = 0.02) -> tuple:
    """Grid of the distance to two plates beside the slot, -thick < z < 0; uniform along the slot."""
    width, _, slot = size.metres
    half = math.ceil((width / 2 + 0.01) / spacing)
    x = np.arange(-half, half + 1) * spacing
    z = np.arange(-int(1.0 / spacing), int((top + 0.05) / spacing) + 1) * spacing
    beside = np.abs(x)[:, None] - slot / 2  # positive above or below a plate
    beyond = np.maximum(z, -thick - z)[None, :]  # positive where a plate's height is left
    over = np.where(beyond > 0, beyond, np.maximum(beyond, -beside))
    around = np.hypot(beside, np.maximum(beyond, 0))
    values = np.repeat(np.where(beside >= 0, over, around)[:, None, :], 2, axis=1)
    return np.asfortranarray(values, np.float32), (float(x[0]), -1.0, float(z[0])), (spacing, 2.0, spacing)


class DemEngine:
    """DEM-Engine: Hertz-Mindlin with forces in single precision, asynchronous contact detection at an adaptive period.

    Settings are those that its documentation recommends for speed. Side walls are planes. A plane is the floor until
    the opening; then two plates of triangles are, beside the slot. Kernels are compiled for each scene.
    """

    def __init__(self, size: Size, x: np.ndarray):
        deme: Any = import_module("deme")
        self.version = str(deme.__version__)
        self.skin: float | None = None
        width, depth, slot = size.metres
        sim = self._sim = deme.DEMSolver(1)
        sim.SetVerbosity("ERROR")
        sim.SetCudaDebugSync(False)
        sim.SetGPUTimersEnabled(False)
        sim.UseFrictionalHertzianModel()
        sim.SetNoForceRecord(True)
        sim.SetExpandSafetyAdder(SAFETY)
        sim.SetInitBinSizeAsMultipleOfSmallestSphere(4)
        young = 2 * SHEAR_MODULUS * (1 + POISSON_RATIO)
        stuff = sim.LoadMaterial({"E": young, "nu": POISSON_RATIO, "CoR": RESTITUTION, "mu": FRICTION, "Crr": 0.0})
        half_width, half_depth, top = width / 2 + 0.01, depth / 2 + 0.01, float(x[:, 2].max()) + 0.1
        sim.InstructBoxDomainDimension((-half_width, half_width), (-half_depth, half_depth), (-0.6, top))
        sim.InstructBoxDomainBoundingBC("none", stuff)
        for sign in (-1, 1):
            sim.AddBCPlane([sign * width / 2, 0, 0], [-sign, 0, 0], stuff)
            sim.AddBCPlane([0, sign * depth / 2, 0], [0, -sign, 0], stuff)
        sim.AddBCPlane([0, 0, 0], [0, 0, 1], stuff).SetFamily(2)
        sim.SetFamilyFixed(2)
        sim.SetFamilyFixed(3)
        sim.DisableContactBetweenFamilies(0, 3)
        ball = sim.LoadSphereType(DENSITY * math.pi / 6 * DIAMETER**3, DIAMETER / 2, stuff)
        grains = sim.AddClumps(ball, x.tolist())
        grains.SetVel(np.zeros_like(x).tolist())
        grains.SetFamily(0)
        self._tracker = sim.Track(grains)
        sim.SetTimeStepSize(DT)
        sim.SetGravitationalAcceleration([0, 0, -GRAVITY])
        sim.SetErrorOutVelocity(30.0)
        with tempfile.TemporaryDirectory() as folder:
            for sign in (-1, 1):
                path = Path(folder) / f"plate{sign}.obj"
                path.write_text(_plate(sign, width, depth, slot))
                sim.AddWavefrontMeshObject(str(path), stuff, False, False).SetFamily(3)
            sim.Initialize()

    def advance(self, steps: int) -> None:
        self._sim.DoDynamicsThenSync(steps * DT)

    def positions(self) -> np.ndarray:
        return np.asarray(self._tracker.Positions(), float).reshape(-1, 3)

    def open(self) -> None:
        self._sim.EnableContactBetweenFamilies(0, 3)
        self._sim.DisableContactBetweenFamilies(0, 2)
        self._sim.RequestContactUpdate()


def _plate(sign: int, width: float, depth: float, slot: float) -> str:
    """Wavefront OBJ of one plate of the floor: its top at z = 0, and its face towards the slot, 2 d deep."""
    cell = 2 * DIAMETER
    inner, outer = sign * slot / 2, sign * (width / 2 + 0.005)
    x = np.linspace(min(inner, outer), max(inner, outer), max(2, int(abs(outer - inner) / cell) + 2))
    y = np.linspace(-depth / 2 - 0.005, depth / 2 + 0.005, max(2, int(depth / cell) + 3))
    vertices: list[tuple[float, float, float]] = []
    faces: list[tuple[int, int, int]] = []

    def add(rows: Sequence[Sequence[tuple[float, float, float]]], flipped: bool) -> None:
        first, across = len(vertices) + 1, len(rows[0])  # OBJ counts from 1
        vertices.extend(itertools.chain.from_iterable(rows))
        for i, j in itertools.product(range(len(rows) - 1), range(across - 1)):
            a = first + i * across + j
            b, c, d = a + across, a + across + 1, a + 1
            faces.extend([(c, b, a), (d, c, a)] if flipped else [(a, b, c), (a, c, d)])

    add([[(p, q, 0.0) for q in y] for p in x], flipped=False)  # normals are up
    add([[(inner, q, -down) for down in (0.0, cell / 2, cell)] for q in y], flipped=sign < 0)  # and towards the slot
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*vertex) for vertex in vertices]
    return "\n".join([*lines, *("f {} {} {}".format(*face) for face in faces), ""])


CODES: dict[str, Callable[[Size, np.ndarray], Code]] = {"peclet": Peclet, "deme": DemEngine}


def discharge(code: str, bed: np.ndarray, grains: int, timings: int, say: Callable[[dict], None]) -> None:
    """Relax a bed, open the slot, and time `timings` times STEPS steps from 0.05 s on; of peclet, other skins too.

    Args:
        code: a key of CODES.
        bed: centres [m] of the first bed, shape [FIRST_BED, 3].
        grains: a key of SIZES.
        timings: how many.
        say: called with the version, the seconds until the bed is relaxed, and the rate of each timing [million
            grain-steps/s] with its outflow [grains/s]. Grains that have left count in the rate: they fall on.
    """
    size = SIZES[grains]
    began = time.perf_counter()
    peer = CODES[code](size, side_by_side(bed, size))
    say({"version": peer.version})
    peer.advance(RELAX)
    say({"start": time.perf_counter() - began})
    peer.open()
    peer.advance(STEPS)
    outside = _below(peer)

    def timed(steps: int) -> float:
        began = time.perf_counter()
        peer.advance(steps)
        return steps * grains / (time.perf_counter() - began) / 1e6

    for _ in range(timings):
        rate, before = timed(STEPS), outside
        outside = _below(peer)
        say({"rate": rate, "outflow": (outside - before) / (STEPS * DT), "skin": peer.skin})
    for skin in SKINS[1:] if peer.skin else ():
        peer.skin = skin
        peer.advance(200)  # makes the lists anew
        say({"rate": timed(STEPS // 5), "skin": peer.skin})


def _below(peer: Code) -> int:
    return int((peer.positions()[:, 2] < 0).sum())


def main() -> None:
    """Run, and print lines of JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("code", choices=sorted(CODES))
    parser.add_argument("bed", type=Path, help="Positions of the first bed, as gpu.py writes them.")
    parser.add_argument("grains", type=int, choices=sorted(SIZES))
    parser.add_argument("--timings", type=int, default=2)
    options = parser.parse_args()
    with np.load(options.bed) as stored:
        bed = stored["x"]
    discharge(options.code, bed, options.grains, options.timings, lambda line: print(json.dumps(line), flush=True))
    os._exit(0)  # threads of DEM-Engine may outlive the interpreter


if __name__ == "__main__":
    main()
