"""Rods at walls of triangles: flat on a sheet as on a plane, over ridges without loss, over an edge as statics say."""

import math
from collections.abc import Mapping

import numpy as np

from labbook.backend.probes import Contacts, Ledger
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.materials import G, floor
from labbook.checks.verify.mesh import of_triangles, sheet
from labbook.checks.verify.platform import MemberStart, Platform, require
from labbook.checks.verify.rods import HALF, MOTION, ROD, R, rods, rods_at, towards
from labbook.scene import Primitives

DT = 5e-6
CONTACTS = Contacts(every=1)
ENERGY = Ledger(every=1)
PROBES = (MOTION, CONTACTS, ENERGY)
NAMES = ("x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz", "qw", "qx", "qy", "qz")
LOSSLESS = {"friction": 0.0, "restitution": 1.0}


def along(direction: float, tilt: float = 0.0) -> np.ndarray:
    """Quaternion of a rod.

    Args:
        direction: Azimuth of its axis from the x axis [rad].
        tilt: Angle of its axis above the horizontal [rad].

    Returns:
        Unit quaternion (w, x, y, z).
    """
    flat = math.cos(tilt)
    return towards(np.array([math.cos(direction) * flat, math.sin(direction) * flat, math.sin(tilt)]))


def _plane(platform: Platform) -> Mapping[str, float]:
    """Rods that land with one end first and slide, turn and roll over edges and vertices of a sheet."""
    vertices, triangles = sheet(6, 6 * HALF)
    tilts, directions = (0.05, 0.0), (0.3, 1.9)
    x = [[-2 * HALF, 0.0, R + HALF * math.sin(tilts[0])], [2 * HALF, 0.1 * R, R]]
    q = [along(direction, tilt) for direction, tilt in zip(directions, tilts, strict=True)]
    start = rods_at(x, q, [[0.1, 0.2, -0.05], [-0.3, 0.05, -0.05]], [[0.0, 0.0, 20.0], [10.0, 0.0, -30.0]])
    ends = []
    for wall in (floor(), of_triangles(vertices, triangles)):
        of = rods(2, Primitives(parts=(wall,)), gravity=G, friction=0.3, restitution=0.5, rolling_friction=0.02)
        ends.append(platform.run(MemberStart(of, 4 * DT, start), 10, 60, PROBES).by_beat(MOTION, NAMES))
    away = np.abs(ends[1] - ends[0]).max(axis=(0, 1))
    require(float(np.ptp(ends[0][..., 0], axis=0).max()) > R / 2, "no rod slid")
    return {"|x - x on a plane|/R": float(away[:3].max()) / R, "axis": float(away[9:].max())}


def _ridge(platform: Platform) -> Mapping[str, float]:
    """Rods that fall across the ridge of a roof and the tip of a pyramid, off their centres, with both ends free."""
    a, high = 8 * HALF, 10 * HALF
    roof = of_triangles(
        np.array([[-a, -a, -high], [-a, a, -high], [0, -a, 0], [0, a, 0], [a, -a, -high], [a, a, -high]]),
        np.array([[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]]),
    )
    tip = of_triangles(
        np.array([[-a, -a, -high], [a, -a, -high], [a, a, -high], [-a, a, -high], [0, 0, 0]]),
        np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]),
    )
    starts, speed = [], 0.25
    for wall in (roof, tip):
        for off, direction, tilt in ((0.0, 0.2, 0.0), (0.4, 0.4, 0.3), (-0.7, -0.5, 0.1)):
            q = along(direction, tilt)
            lever = off * HALF * np.array([math.cos(direction), math.sin(direction), math.tan(tilt)])
            packing = rods_at([lever + np.array([0.0, 0.0, 1.2 * R])], [q], [[0.0, 0.0, -speed]])
            of = rods(1, Primitives(parts=(wall,)), normal_stiffness=2e3, **LOSSLESS)
            starts.append(MemberStart(of, 0.4 * DT, packing))
    energy = []
    for trajectory in platform.run_all(starts, 60, 50, PROBES):
        kinetic = trajectory.rows(ENERGY)["kinetic"]
        rows = trajectory.rows(CONTACTS)
        require(len(rows["step"]) > 3, "a rod was not turned aside")
        require(len(np.unique(rows["step"])) == len(rows["step"]), "a rod touched at two points")
        energy.append(abs(kinetic[-1] / (0.5 * ROD.mass * speed**2) - 1))
    return {"energy after/before - 1": float(max(energy))}


def _ledge(platform: Platform) -> Mapping[str, float]:
    """A rod at rest on a plate, with a part of it beyond an edge: its end and the edge share its weight m g as the
    levers from its centre say."""
    far = 8 * HALF
    plate = of_triangles(
        np.array([[-far, -far, 0], [-far, far, 0], [0, -far, 0], [0, 0, 0], [0, far, 0]]),
        np.array([[0, 2, 3], [0, 3, 1], [1, 3, 4]]),
    )
    starts, centres = [], (-0.8, -0.5, -0.2)
    for centre in centres:
        of = rods(1, Primitives(parts=(plate,)), gravity=G, friction=0.5, restitution=0.1)
        level = R - 0.5 * ROD.mass * G / of.contact.model_dump()["normal_stiffness"]
        starts.append(MemberStart(of, DT, rods_at([[centre * HALF, 0.3 * R, level]], [along(0.0)])))
    errors, counts = [], []
    for centre, trajectory in zip(centres, platform.run_all(starts, 4, 2000, PROBES), strict=True):
        table = trajectory.rows(CONTACTS)
        last = table["step"] == table["step"].max()
        at, force = table["bx"][last] + centre * HALF, table["fz"][last]
        counts.append(abs(len(at) - 2))
        end, edge = (centre - 1) * HALF, 0.0
        weight = ROD.mass * G
        expected = weight * np.array([edge - centre * HALF, centre * HALF - end]) / (edge - end)
        order = np.argsort(at)
        require(len(at) == 2, f"a rod touches at {len(at)} points")
        errors.append(float(np.abs(force[order] / expected - 1).max()))
    return {"N/(m g L) - 1": max(errors), "|contacts - 2|": float(max(counts))}


CASES = [
    Case(
        name="mesh-rod-plane",
        statement="rods land, slide and roll over a sheet of triangles, across edges and vertices, as on a plane",
        source="the same on a plane",
        measures={"|x - x on a plane|/R": limited(1e-9, steps=6e3), "axis": limited(1e-9, roundings=100, steps=6e3)},
        run=_plane,
    ),
    Case(
        name="mesh-rod-ridge",
        statement="rods bounce off a ridge and a tip between their ends, at one point and without loss",
        source="conservation of energy",
        measures={"energy after/before - 1": limited(1e-5, roundings=2000, steps=2e4)},
        run=_ridge,
    ),
    Case(
        name="mesh-rod-ledge",
        statement="a rod at rest over the edge of a plate is carried by its end and the edge",
        source="statics",
        measures={"N/(m g L) - 1": limited(1e-3, roundings=1000), "|contacts - 2|": limited(0.0)},
        run=_ledge,
    ),
]
