"""Input of LIGGGHTS and LAMMPS for scenes of spheres: grains, contact law and walls of any container.

LIGGGHTS gets planes and the cylinder around a round silo as primitives, and every other wall as a triangle mesh (STL),
the mesh that pictures of labbook show. Round rims and cones have 96 corners there: with more, a grain touches several
edges at a time, and LIGGGHTS adds their forces. LAMMPS has no meshes: plates are thin blocks or prisms,
cones are regions without caps. At round walls its effective radius includes their curvature, so that they are a few per
cent stiffer than those of labbook. Both codes read grains from the data file that `labbook export --packings` writes.
"""

import itertools
import math
from collections.abc import Iterator, Sequence

from forces import HEAD, wall_stiffness
from impact import tsuji
from scipy.optimize import root_scalar

from labbook.export.packing import around, data_file
from labbook.export.stl import stl
from labbook.scene import (
    ConicalSilo,
    ContactLaw,
    CylinderSilo,
    HertzLammps,
    HertzLiggghts,
    Scene,
    Surface,
    WedgeHopper,
)
from labbook.scene.geometry import Bounds
from labbook.scene.packing import Packing
from labbook.scene.walls import AT_REST, Frustum, Plane, Point2, Strip, Wall, WallShape

LEAST_RESTITUTION = 0.05
"""Restitution below which LIGGGHTS refuses a material."""
LEAST_MODULUS = 5e6
"""Young's modulus [Pa] below which LIGGGHTS refuses a material in SI units."""
THIN = 1e-8
"""Thickness [m] of plates in LAMMPS."""
LIGGGHTS = """
fix m1 all property/global youngsModulus peratomtype {young}
fix m2 all property/global poissonsRatio peratomtype {nu}
fix m3 all property/global coefficientRestitution peratomtypepair {restitution}
fix m4 all property/global coefficientFriction peratomtypepair {friction}
{rolling_property}
pair_style gran model hertz tangential history{rolling}{settings}
pair_coeff * *
"""
TAIL = """
fix down all gravity {g} vector 0 0 -1
fix go all nve/sphere
"""


class Unsupported(Exception):
    """A scene that a code, or its deck, cannot represent; the message names the key and the remedy."""


def law_of(code: str, law: ContactLaw) -> ContactLaw:
    """The contact law of a code with the parameters of another law by Hertz.

    Raises:
        Unsupported: a law without elastic moduli.
    """
    if isinstance(law, {"liggghts": HertzLiggghts, "lammps": HertzLammps}[code]):
        return law
    if law.material is None:
        raise Unsupported(f"contact.law {law.law} has no elastic moduli; use a law by Hertz")
    keys = ("shear_modulus", "poisson_ratio", "friction", "rolling_friction", "restitution", "rolling", "between")
    shared = {key: getattr(law, key) for key in keys}
    return HertzLiggghts(**shared) if code == "liggghts" else HertzLammps(**shared)


def deck(code: str, scene: Scene, packing: Packing, dt: float) -> tuple[str, dict[str, str]]:
    """Input of a code up to the first step.

    Args:
        code: `liggghts` or `lammps`.
        scene: the open scene, with the law of that code.
        packing: its grains at the start.
        dt: time step [s].

    Returns:
        The script, and the other files that it reads by name.

    Raises:
        Unsupported: see `check`.
    """
    check(code, scene)
    walls, law = scene.container.walls(), scene.contact
    words = {"dt": dt, "g": scene.gravity, "skin": 0.2 * scene.grains.diameter}
    box = around(scene, packing)
    bed = data_file(packing, scene, "labbook packing")
    if code == "lammps":
        words |= {"style": "sphere", "velocities": "comm_modify vel yes"}
        lines = [*_lammps_pairs(scene), *(line for wall in walls for line in _lammps_wall(scene, wall, box))]
        return HEAD.format(**words) + "\n".join(lines) + TAIL.format(**words), {"bed.data": bed}
    kinds = len(scene.grains.species)
    types = kinds + len(walls)
    bed = bed.replace(f"\n{kinds} atom types\n", f"\n{types} atom types\n", 1)
    rolling = " rolling_friction cdt" if _rolls(scene) else ""
    settings = " torsionTorque on" if rolling and law.rolling == "full" else ""
    settings += "" if getattr(law, "tension", True) else " limitForce on"
    words |= {
        "style": "granular", "velocities": "communicate single vel yes", "rolling": rolling,
        "settings": settings, **_liggghts_materials(scene, walls),
    }  # fmt: skip
    model = f"all wall/gran model hertz tangential history{rolling}"
    lines, meshes, files = [], [], {"bed.data": bed}
    for number, wall in enumerate(walls, kinds + 1):
        primitive = _primitive(scene, wall)
        mesh = None if primitive else wall.shape.mesh(box)
        if primitive:
            lines.append(f"fix {_word(wall)} {model} primitive type {number} {primitive}{settings}")
        elif mesh is not None:
            files[f"{wall.name}.stl"] = stl(mesh, wall.name)
            lines.append(f"fix {_word(wall)} all mesh/surface file {wall.name}.stl type {number}")
            meshes.append(_word(wall))
    if meshes:  # LIGGGHTS has one wall of meshes
        named = f"n_meshes {len(meshes)} meshes {' '.join(meshes)}"
        lines.append(f"fix meshes {model} mesh {named}{settings}")
    return (HEAD + LIGGGHTS).format(**words) + "\n".join(lines) + TAIL.format(**words), files


def check(code: str, scene: Scene) -> None:
    """Refuse scenes that a code cannot represent.

    Raises:
        Unsupported: names the key and the remedy.
    """
    law = scene.contact
    if not isinstance(law, HertzLiggghts if code == "liggghts" else HertzLammps):
        raise Unsupported(f"contact.law {law.law} is not the law of {code}; use hertz-{code}")
    if scene.grains.shape != "sphere":
        raise Unsupported("grains.shape: both codes get spheres only")
    if scene.has_own_stiffness:
        raise Unsupported("kinds or walls with moduli of their own: leave these out, so that contact has the only ones")
    if scene.feed is not None or any(wall.motion != AT_REST for wall in scene.container.walls()):
        raise Unsupported("feed and moving walls: leave them out")
    if law.rolling_model != "cdt" and _rolls(scene):
        raise Unsupported("contact.rolling_model: use cdt, or rolling_friction 0")
    ratios = [law.damping_ratio(surface.restitution) for surface in scene.surfaces]
    if code == "lammps":
        if _rolls(scene):
            raise Unsupported("contact.rolling_friction: LAMMPS resists rolling by another law; use 0")
        if max(ratios) > tsuji(0):
            raise Unsupported(f"contact.restitution: LAMMPS has no C_n above {tsuji(0):.3f}; use a larger restitution")
        return
    if law.tangential_damping != 1:
        raise Unsupported("contact.tangential_damping: LIGGGHTS damps normal and tangent equally; leave it out")
    if _young(law) < LEAST_MODULUS:
        raise Unsupported(f"contact.youngs_modulus: LIGGGHTS refuses {_young(law):g} Pa; use at least 5 MPa")
    if min(restitution(ratio) for ratio in ratios) < LEAST_RESTITUTION:
        raise Unsupported(f"contact.restitution: LIGGGHTS needs at least {LEAST_RESTITUTION}; use a larger restitution")


def restitution(c_n: float) -> float:
    """The restitution of which LIGGGHTS' formula, sqrt(5/6) L/sqrt(pi^2 + L^2) with L = ln(1/e), makes C_n."""
    x = c_n / math.sqrt(5 / 6)
    return math.exp(-math.pi * x / math.sqrt(1 - x * x))


def eta(c_n: float) -> float:
    """The restitution with which LAMMPS' tsuji model damps by C_n."""
    return root_scalar(lambda e: tsuji(e) - c_n, bracket=(0.0, 1.0)).root


def _young(law: ContactLaw) -> float:
    assert law.material is not None
    return 2 * law.material.shear_modulus * (1 + law.material.poisson_ratio)


def _rolls(scene: Scene) -> bool:
    return any(surface.rolling_friction for surface in scene.surfaces)


def _word(wall: Wall) -> str:
    """A name that both codes take, and no other fix has."""
    return "wall_" + wall.name.replace("-", "_")


def _numbers(values) -> str:
    return " ".join(repr(float(value)) for value in values)


def _primitive(scene: Scene, wall: Wall) -> str | None:
    """A plane across an axis, or a side wall that has no opening, as LIGGGHTS writes it: unbounded and exact."""
    shape, sides = wall.shape, isinstance(scene.container, WedgeHopper | CylinderSilo | ConicalSilo)
    if isinstance(shape, Plane):
        across = [axis for axis, part in enumerate(shape.normal) if part]
        if len(across) > 1:
            raise Unsupported("container.parts: inclined planes have no primitive; use a strip")
        return f"{'xyz'[across[0]]}plane {shape.point[across[0]]!r}"
    if sides and isinstance(shape, Strip) and shape.start[0] == shape.end[0]:
        return f"xplane {shape.start[0]!r}"
    if sides and isinstance(shape, Frustum) and shape.lower[0] == shape.upper[0]:
        return f"zcylinder {shape.reach!r} 0 0"
    return None


def _liggghts_materials(scene: Scene, walls: Sequence[Wall]) -> dict[str, str]:
    """Properties of all types: first kinds of grains, then walls."""
    law, kinds = scene.contact, len(scene.grains.species)
    types = kinds + len(walls)

    def surface(a: int, b: int) -> Surface:
        a, b = sorted((a, b))
        if b < kinds:
            return scene.surface_between(a, b)
        return scene.surface(walls[b - kinds], a if a < kinds else 0)  # walls do not touch walls

    pairs = [surface(a, b) for a in range(types) for b in range(types)]
    words = {
        "young": " ".join([repr(_young(law))] * types),
        "nu": " ".join([repr(law.material.poisson_ratio)] * types) if law.material else "",
        "restitution": f"{types} " + _numbers(restitution(law.damping_ratio(pair.restitution)) for pair in pairs),
        "friction": f"{types} " + _numbers(pair.friction for pair in pairs),
        "rolling_property": "",
    }
    if _rolls(scene):
        values = _numbers(pair.rolling_friction for pair in pairs)
        words["rolling_property"] = (
            f"fix m5 all property/global coefficientRollingFriction peratomtypepair {types} {values}"
        )
    return words


def _lammps_contact(scene: Scene, surface: Surface, normal: str, k_t: object) -> str:
    """Normal and tangential model of a contact."""
    law = scene.contact
    assert isinstance(law, HertzLammps)
    damping = f"damping tsuji{'' if law.tension else ' limit_damping'}"
    gives = eta(law.damping_ratio(surface.restitution))
    return normal.format(eta=repr(gives)) + (
        f" tangential mindlin {k_t} {law.tangential_damping} {surface.friction} {damping}"
    )


def _lammps_pairs(scene: Scene) -> Iterator[str]:
    law, kinds = scene.contact, range(len(scene.grains.species))
    assert law.material is not None
    yield "pair_style granular"
    for a, b in itertools.combinations_with_replacement(kinds, 2):
        normal = f"hertz/material {_young(law)!r} {{eta}} {law.material.poisson_ratio!r}"
        yield f"pair_coeff {a + 1} {b + 1} {_lammps_contact(scene, scene.surface_between(a, b), normal, 'NULL')}"
    for kind in kinds:
        yield f"group kind{kind + 1} type {kind + 1}"


def _lammps_wall(scene: Scene, wall: Wall, box: Bounds) -> Iterator[str]:
    """A wall, for each kind of grains: the model of its contacts has no types."""
    law, name = scene.contact, _word(wall)
    assert law.material is not None
    stiffness = wall_stiffness(_young(law), law.material.poisson_ratio)
    normal = f"hertz {stiffness['k_n']!r} {{eta}}"
    primitive = _primitive(scene, wall)
    if primitive is None:
        yield f"region {name} {_region(wall.shape, box)}"
        style, where = "wall/gran/region", f"region {name}"
    elif primitive.startswith("zcylinder"):
        style, where = "wall/gran", " ".join(primitive.split()[:2])
    else:
        style, (plane, at) = "wall/gran", primitive.split()
        after = sum(wall.shape.normal) > 0 if isinstance(wall.shape, Plane) else float(at) < 0  # grains lie there
        where = f"{plane} {at} NULL" if after else f"{plane} NULL {at}"
    for kind in range(len(scene.grains.species)):
        contact = _lammps_contact(scene, scene.surface(wall, kind), normal, repr(stiffness["k_t"]))
        yield f"fix {name}{kind + 1} kind{kind + 1} {style} granular {contact} {where}"


def _cut(start: Point2, end: Point2, top: float) -> tuple[Point2, Point2]:
    """The lower and the upper end [m] of a segment, cut at the height `top` [m]."""
    (u0, z0), (u1, z1) = sorted((start, end), key=lambda edge: edge[1])
    if z1 > top > z0:
        u1, z1 = u0 + (u1 - u0) * (top - z0) / (z1 - z0), top
    return (u0, z0), (u1, z1)


def _region(shape: WallShape, box: Bounds) -> str:
    """A thin plate or a cone as a region of LAMMPS, whose surface grains touch from outside, or from both sides."""
    if isinstance(shape, Strip):
        (x0, z0), (x1, z1) = _cut(shape.start, shape.end, box.high[2])
        front, back = box.low[1], box.high[1]
        if z0 == z1:
            low, high = sorted((x0, x1))
            return f"block {low!r} {high!r} {front!r} {back!r} {z0 - THIN!r} {z0!r} side out"
        # a plate of which grains touch either face: its middle is the strip
        left, right = x0 - THIN / 2, x0 + THIN / 2
        return f"prism {left!r} {right!r} {front!r} {back!r} {z0!r} {z1!r} 0 {x1 - x0!r} 0 side out"
    if isinstance(shape, Frustum):
        (r0, z0), (r1, z1) = _cut(shape.lower, shape.upper, box.high[2])
        if z0 == z1:
            z0 -= THIN
        return f"cone z 0 0 {r0!r} {r1!r} {z0!r} {z1!r} open 1 open 2"
    raise Unsupported(f"container: LAMMPS has no region for a wall of kind {shape.kind}")
