"""Forces and torques of LIGGGHTS and LAMMPS at given states, beside those of the laws named after them.

Pairs of spheres of Fan's material, and single ones at a wall, are read from a data file that labbook writes, with
random overlaps (to 1 % of d), velocities and spins. Nothing integrates their motion, so that positions and velocities
stay and each step only adds v_t dt to the friction spring, and cuts it where the law does. Then forces are dumped with
15 digits. labbook's are those of `labbook_dem` at the same states, its spring advanced by as many steps. Contacts
approach and part, stick and slide, and are pulled where the law lets them. Levers are radii less the overlap at walls
here, radii less half of it in LIGGGHTS, and whole radii in LAMMPS, there and for velocities everywhere: so states
without spins are compared as well, and torques at walls by the other lever. Needs Debian's packages liggghts and
lammps.

    python benchmarks/peers/forces.py --out forces.json
"""

import argparse
import itertools
import json
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from impact import DENSITY, MU, NU, YOUNG, D, E, G, tsuji
from labbook_dem.chosen import choose
from labbook_dem.spheres import sphere_on_sphere, sphere_on_wall
from labbook_dem.words import vec3

from labbook.export.packing import data_file
from labbook.scene import HertzLammps, HertzLiggghts, Scene, Surface
from labbook.scene.packing import Packing

STATES, STEPS, DT = 200, 200, 1e-7
SPEED, SPIN, OVERLAP = 0.5, 300.0, 0.01  # m/s, rad/s, parts of d
_ETA = 0.6
_FAR = 4 * D  # between two states

HEAD = """
units si
atom_style {style}
atom_modify map array
boundary f f f
newton off
{velocities}
read_data bed.data
neighbor {skin} bin
neigh_modify delay 0
timestep {dt}
"""
LAWS = {
    "liggghts": """
fix m1 all property/global youngsModulus peratomtype {young}
fix m2 all property/global poissonsRatio peratomtype {nu}
fix m3 all property/global coefficientRestitution peratomtypepair 1 {e}
fix m4 all property/global coefficientFriction peratomtypepair 1 {mu}
pair_style gran model hertz tangential history{limit}
pair_coeff * *
fix floor all wall/gran model hertz tangential history primitive type 1 zplane 0{limit}
""",
    "lammps": """
pair_style granular
pair_coeff * * hertz/material {young} {eta} {nu} tangential mindlin NULL 1.0 {mu} damping tsuji{limit}
fix floor all wall/gran granular hertz {k_n} {eta} tangential mindlin {k_t} 1.0 {mu} damping tsuji{limit} zplane 0 NULL
""",
}
TAIL = """
dump out all custom {steps} dump.txt id fx fy fz tqx tqy tqz
dump_modify out sort id format {line}"%d %20.15g %20.15g %20.15g %20.15g %20.15g %20.15g"
run {steps}
"""
LIMIT = {"liggghts": " limitForce on", "lammps": " limit_damping"}


@dataclass(frozen=True)
class States:
    """Contacts of grain i with grain j, or with the wall z = 0 below: overlaps [m], shape [n], normals from j to i,
    velocities [m/s] and spins [rad/s] of both, shape [n, 3]."""

    overlap: np.ndarray
    normal: np.ndarray
    v: np.ndarray
    w: np.ndarray
    v2: np.ndarray
    w2: np.ndarray
    wall: bool


def states(wall: bool, spins: bool) -> States:
    """Random ones, always the same."""
    rng = np.random.default_rng(7)
    normal = rng.normal(size=(STATES, 3))
    normal = np.tile([0.0, 0, 1], (STATES, 1)) if wall else normal / np.linalg.norm(normal, axis=1)[:, None]
    v, w, v2, w2 = (rng.uniform(-1, 1, (STATES, 3)) * size for size in (SPEED, SPIN, SPEED, SPIN))
    off = np.zeros((STATES, 3))
    w, v2, w2 = (w if spins else off), (off if wall else v2), (w2 if spins and not wall else off)
    # slow ones stick, and are what springs decide
    slow = 10.0 ** rng.uniform(-3, 0, (STATES, 1))
    return States(rng.uniform(0.02, 1, STATES) * OVERLAP * D, normal, v * slow, w * slow, v2 * slow, w2 * slow, wall)


def packing(found: States) -> Packing:
    """The states as one packing: a row of pairs well above the floor, or a row of spheres on it."""
    place = np.column_stack([np.arange(STATES) * _FAR, np.zeros(STATES), np.full(STATES, 10 * D)])
    if found.wall:
        place[:, 2] = D / 2 - found.overlap
        return Packing(x=place, v=found.v, omega=found.w)
    x = np.vstack([place + found.normal * (D - found.overlap)[:, None], place])
    return Packing(x=x, v=np.vstack([found.v, found.v2]), omega=np.vstack([found.w, found.w2]))


def wall_stiffness(young: float, nu: float) -> dict[str, float]:
    """Stiffness [Pa] along the normal, 4/3 E*, and tangent, 8 G*, of a wall of the grains' material.

    LAMMPS is given these numbers, since its own for walls of `hertz/material` (January 2022) are E/(2 (1 - nu)) for E*
    and E/4 (2 - nu) (1 + nu) for 8 G*, unlike those between grains.
    """
    return {"k_n": 4 / 3 * young / (2 * (1 - nu**2)), "k_t": 8 * young / (4 * (2 - nu) * (1 + nu))}


def theirs(code: str, found: States, tension: bool) -> np.ndarray:
    """Force [N] and torque [N m] on grain i of each state, shape [n, 6]."""
    liggghts, bed = code == "liggghts", packing(found)
    words = {
        "style": "granular" if liggghts else "sphere", "dt": DT, "skin": 0.001, "young": YOUNG,
        "nu": NU, "e": E, "mu": MU, "eta": _ETA, "steps": STEPS,
        "line": "" if liggghts else "line ", "limit": "" if tension else LIMIT[code],
        "velocities": "communicate single vel yes" if liggghts else "comm_modify vel yes", **wall_stiffness(YOUNG, NU),
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "bed.data").write_text(data_file(bed, scene(len(bed)), "states"))
        (Path(folder) / "in.forces").write_text((HEAD + LAWS[code] + TAIL).format(**words))
        program = "liggghts" if liggghts else "lmp"
        done = subprocess.run([program, "-in", "in.forces"], cwd=folder, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{program}: {(done.stdout + done.stderr)[-800:]}")
        rows = (Path(folder) / "dump.txt").read_text().strip().splitlines()[-len(bed) :]
    return np.array([[float(word) for word in row.split()[1:]] for row in rows])[:STATES]


def scene(count: int) -> Scene:
    """Spheres of Fan's material."""
    grains = {"shape": "sphere", "diameter": D, "density": DENSITY, "count": count}
    free = {"kind": "primitives", "parts": []}
    return Scene.model_validate({"grains": grains, "contact": law("liggghts", True), "container": free})


def law(code: str, tension: bool) -> HertzLiggghts | HertzLammps:
    """labbook's law of that name, with the code's damping."""
    shared = {"shear_modulus": G, "poisson_ratio": NU, "friction": MU, "restitution": E, "tension": tension}
    if code == "liggghts":
        return HertzLiggghts.model_validate(shared)
    return HertzLammps.model_validate({**shared, "normal_damping": tsuji(_ETA)})


def ours(code: str, found: States, tension: bool) -> np.ndarray:
    """The same by labbook's formulas, in plain Python."""
    contact = law(code, tension)
    surface = Surface(friction=MU, rolling_friction=0, restitution=E)
    mass, result = DENSITY * np.pi / 6 * D**3, []
    with choose(contact.law) as formulas:
        c = formulas.coefficients(contact, surface, 1.0, found.wall)
        for k in range(STATES):
            u, delta, n = vec3(*(found.v[k] - found.v2[k])), found.overlap[k], vec3(*found.normal[k])
            w, w2, s = vec3(*found.w[k]), vec3(*found.w2[k]), vec3(0.0, 0.0, 0.0)
            for _ in range(STEPS):
                if found.wall:
                    force, torque, s = sphere_on_wall(
                        c, D / 2, mass, delta, n, u, u, w, vec3(0.0, 0.0, 0.0), s, DT, 0.0
                    )  # fmt: skip
                else:
                    r = D - delta
                    force, torque, _, s, _ = sphere_on_sphere(
                        c, D / 2, D / 2, mass, mass, n * r, D**2 - r**2, u, u, w, w2, s, DT, 0.0, 0.0
                    )  # fmt: skip
            result.append([force.x, force.y, force.z, torque.x, torque.y, torque.z])
    return np.array(result)


def main() -> None:
    """Compare, print and write."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--out", type=Path)
    said = words.parse_args()
    rows = []
    for code, wall, spins, tension in itertools.product(LAWS, (False, True), (False, True), (True, False)):
        found = states(wall, spins)
        a, b = theirs(code, found, tension), ours(code, found, tension)
        apart = [np.linalg.norm(a[:, part] - b[:, part], axis=1) / np.linalg.norm(a[:, part], axis=1).clip(1e-30)
                 for part in (slice(3), slice(3, 6))]  # fmt: skip
        shorter = found.overlap * {"liggghts": 0.5, "lammps": 0.0}[code]
        longer = (D / 2 - shorter) / (D / 2 - found.overlap) if wall else np.ones(STATES)
        levered = np.linalg.norm(a[:, 3:] - b[:, 3:] * longer[:, None], axis=1)
        levered /= np.linalg.norm(a[:, 3:], axis=1).clip(1e-30)
        rows.append({
            "code": code, "at": "wall" if wall else "sphere", "spins": spins, "tension": tension, "states": STATES,
            "force, largest": apart[0].max(), "force, median": np.median(apart[0]),
            "torque, largest": apart[1].max(), "torque, median": np.median(apart[1]),
            "torque by their lever, largest": levered.max(),
        })  # fmt: skip
    told = pd.DataFrame(rows)
    print(told.to_string(index=False, float_format="%.1e"))
    if said.out:
        said.out.write_text(json.dumps({"steps": STEPS, "dt": DT, "rows": rows}, indent=1, default=float))


if __name__ == "__main__":
    main()
