"""Bodies of one package fall on its wall, by its law: prints, as JSON, what came of it on the backend named."""

import json
import sys

import numpy as np

from labbook.backend import load
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts
from labbook.export.wall_shapes import drawn_walls
from labbook.scene import CONTACT_LAWS, Primitives, Scene, Spheres, Spherocylinders, Wall
from labbook.scene.packing import Packing
from labbook.scene.walls import WALL_SHAPES

D, SPEED, STIFFNESS, RADIUS = 3e-3, 0.5, 1e9, 10e-3
"""Diameter [m], speed [m/s], k [Pa] and the radius of the ball [m]."""
DT, GAP = 5e-7, 1e-6
STEPS = 600


def scene(rod: bool, count: int = 1) -> Scene:
    """Bodies above a ball at the origin, without gravity."""
    shape = {"diameter": D, "density": 2500, "count": count}
    ball = {"kind": "ball", "centre": (0.0, 0.0, 0.0), "radius": RADIUS}
    return Scene.model_validate(
        {
            "grains": Spherocylinders(**shape, length=4 * D) if rod else Spheres(**shape),
            "contact": {"law": "quadratic", "stiffness": STIFFNESS},
            "container": Primitives(parts=(Wall.model_validate({"name": "ball", "shape": ball}),)),
            "gravity": 0.0,
        }
    )


def fall(backend, rod: bool, off: float) -> dict[str, object]:
    """One body falls on the ball, its middle `off` [m] beside the ball's; a rod lies."""
    flat = np.array([[np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]])  # along x
    z = RADIUS + D / 2 + GAP
    start = Packing(
        x=np.array([[off, 0.0, z]]), v=np.array([[0.0, 0.0, -SPEED]]), omega=np.zeros((1, 3)), q=flat if rod else None
    )
    case, numerics, probe = scene(rod), Numerics(dt=DT, steps_per_beat=1), Contacts(every=1)
    ensemble = backend.open(backend.specialise(case, numerics, (probe,)))
    member = ensemble.admit(case, numerics, start)
    ensemble.advance(STEPS)
    touched = np.unique(ensemble.drain()[probe]["step"])
    end = ensemble.packing(member)
    return {"v": end.v[0].tolist(), "omega": end.omega[0].tolist(), "steps": len(touched)}


if __name__ == "__main__":
    backend = load(sys.argv[1])
    assert {"quadratic"} <= backend.capabilities.laws <= set(CONTACT_LAWS)
    assert {"ball"} <= backend.capabilities.walls <= set(WALL_SHAPES)
    found = {
        "sphere": fall(backend, False, 0.0),
        "rod": fall(backend, True, 0.0),
        "beside": fall(backend, True, 2 * D / 3),
    }
    (drawn,) = drawn_walls(scene(False), np.array([[0.0, 0.0, RADIUS]]))
    print(json.dumps({**found, "triangles": len(drawn.mesh.triangles)}))
