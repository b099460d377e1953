"""Packings as data files that LIGGGHTS and LAMMPS read (`read_data`, `atom_style sphere`, `units si`), with the walls
around them as STL files."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from labbook.export.stl import wall_files
from labbook.lab.folder import LabFolder, write_bytes
from labbook.lab.packings import read_packing
from labbook.results.study import StudyResults
from labbook.scene import Scene, Spheres
from labbook.scene.bodies import Bodies
from labbook.scene.geometry import Bounds
from labbook.scene.packing import Packing
from labbook.scene.walls import AROUND
from labbook.study import Study

MARGIN, BELOW = 2.0, 20.0
"""Diameters by which the box of a data file is wider than the grains are spread, and deeper than the outlet."""


class NotSpheres(Exception):
    """Packing of grains that these codes do not have; the message says which."""


def check_spheres(study: Study) -> None:
    """Refuse rods.

    Args:
        study: Study.

    Raises:
        NotSpheres: A point of the study has rods.
    """
    for point in study.points:
        _spheres(point.scene)


def _spheres(scene: Scene) -> Spheres:
    if not isinstance(scene.grains, Spheres):
        raise NotSpheres(f"data files hold spheres only, but the grains have the shape {scene.grains.shape}")
    return scene.grains


def data_file(packing: Packing, scene: Scene, title: str) -> str:
    """Write a packing as text: number and kind (both from 1), diameter, density, centre and velocities of each grain.

    Numbers are in SI units, in digits that read back as the same numbers. Friction springs are left out, since neither
    code reads any: contacts start without. The box is that of the grains with a margin, and reaches below z = 0, where
    grains fall to; walls are no part of such a file.

    Args:
        packing: Packing.
        scene: Scene that it belongs to.
        title: First line of the file.

    Returns:
        Text of the file.

    Raises:
        NotSpheres: The grains are rods.
    """
    grains = _spheres(scene)
    bodies = Bodies.of(grains, packing)
    densities = np.array([species.density for species in grains.species])[bodies.kind]
    box = around(scene, packing)
    assert packing.ids is not None
    order = np.argsort(packing.ids)
    lines = [title, "", f"{len(packing)} atoms", f"{len(grains.species)} atom types", ""]
    lines += [f"{_numbers((box.low[k], box.high[k]))} {axis}lo {axis}hi" for k, axis in enumerate("xyz")]
    lines += ["", "Atoms", ""]
    columns = np.column_stack([2 * bodies.radius, densities, packing.x])
    lines += [f"{packing.ids[k] + 1} {bodies.kind[k] + 1} {_numbers(columns[k])}" for k in order]
    lines += ["", "Velocities", ""]
    moving = np.column_stack([packing.v, packing.omega])
    lines += [f"{packing.ids[k] + 1} {_numbers(moving[k])}" for k in order]
    return "\n".join(lines) + "\n"


def around(scene: Scene, packing: Packing) -> Bounds:
    """Find the box of a data file, in which walls are meshed.

    Args:
        scene: Scene.
        packing: Packing.

    Returns:
        Box two diameters wider than the grains, down to where grains fall [m].
    """
    margin = MARGIN * scene.grains.diameter
    (left, front, low), (right, back, top) = (packing.x.min(axis=0) - margin).tolist(), packing.x.max(axis=0) + margin
    low = min(low, -BELOW * scene.grains.diameter)
    return Bounds((left, front, low), (float(right), float(back), float(top)))


def _numbers(row: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in row)


def write_packings(
    results: StudyResults,
    lab: LabFolder,
    folder: Path,
    say: Callable[[str], None] = lambda text: None,
    facets: int = AROUND,
) -> list[Path]:
    """Write every packing of a study's runs once, and the walls of every point.

    Packings are `point-P-seed-S.data`, with the first point P (from 1) that shares it; walls are `point-P-NAME.stl`.

    Args:
        results: Results of the study.
        lab: Lab.
        folder: Folder to write to, made if it is missing.
        say: Function to call with the name of each run.
        facets: Corners of the polygons in place of circles.

    Returns:
        Paths of the files.

    Raises:
        NotSpheres: The grains are rods.
        Unreadable: A packing is damaged.
    """
    paths, keys = [], set[str]()

    def write(name: str, text: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        write_bytes(folder / name, text.encode(), durable=False)
        paths.append(folder / name)

    for result in results.points:
        number, walls_written = result.point.index + 1, False
        for run in result.runs:
            if walls_written and run.packing_key in keys:
                continue
            say(f"{result.label}, seed {run.seed}")
            record, packing = read_packing(lab.packing(run.packing_key))
            packing = packing.entered
            if not walls_written:
                box = around(result.point.scene, packing)
                for name, text in wall_files(result.point.scene.container, box, facets).items():
                    write(f"point-{number}-{name}.stl", text)
                walls_written = True
            if run.packing_key not in keys:
                title = f"labbook packing {run.packing_key} of study {results.study.name}, seed {run.seed}"
                write(f"point-{number}-seed-{run.seed}.data", data_file(packing, record.scene, title))
                keys.add(run.packing_key)
    return paths
