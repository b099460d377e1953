"""Writing a study's exports into a folder."""

import json
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from labbook.export.recording import file_name
from labbook.export.vtk import write_fields, write_grains, write_series, write_walls
from labbook.export.wall_shapes import DrawnWall, drawn_walls
from labbook.fields import axes
from labbook.lab.folder import write_bytes
from labbook.results.frames import frames, inside
from labbook.results.points import PointResult
from labbook.results.recorded import flow_patterns, kind_patterns
from labbook.results.study import StudyResults
from labbook.scene.bodies import kind_names
from labbook.scene.grains import Clumps
from labbook.scene.hulls import sphere_centres
from labbook.scene.orientation import rotated

Format = Literal["csv", "parquet"]


class NoParquet(Exception):
    """pandas has nothing to write Parquet with; the message says what to install."""


def write_numbers(
    results: StudyResults, folder: Path, kind: Format, every: float | None = None, headings: bool = False
) -> list[Path]:
    """Write every number of the analysis, one file a table.

    `units.json` beside the tables has the SI units of their columns; Parquet files have them as `attrs` too.

    Args:
        results: Results of the study.
        folder: Folder to write to, made if it is missing.
        kind: Format of the tables.
        every: Time between the rows of the table `inside`, the grains inside at times [s]; None: without it.
        headings: Write units into the headings of CSV files, as in `container.orifice [m]`, for spreadsheets.

    Returns:
        Paths of the files.

    Raises:
        NoParquet: pandas has nothing to write Parquet with.
        ValueError: There is no such format.
    """
    if kind not in get_args(Format):
        raise ValueError(f"kind: {kind!r} is none of {', '.join(get_args(Format))}")
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    tables = frames(results) | ({} if every is None else {"inside": inside(results, every)})
    units = {name: frame.attrs["units"] for name, frame in tables.items()}
    write_bytes(folder / "units.json", json.dumps(units, indent=2).encode(), durable=False)
    for name, frame in tables.items():
        path = folder / f"{name}.{kind}"
        if kind == "csv":
            units_added = {name: f"{name} [{unit}]" for name, unit in frame.attrs["units"].items() if unit and headings}
            frame = frame.rename(columns=units_added)
            write_bytes(path, frame.to_csv(index=False).encode(), durable=False)
        else:
            buffer = BytesIO()
            try:
                frame.to_parquet(buffer, index=False)
            except ImportError as missing:
                raise NoParquet(
                    "Parquet needs pyarrow: pip install 'labbook[parquet]', or use --format csv"
                ) from missing
            write_bytes(path, buffer.getvalue(), durable=False)
        paths.append(path)
    return paths


def write_recordings(results: StudyResults, folder: Path, say: Callable[[str], None] = lambda text: None) -> list[Path]:
    """Write recorded runs as VTK, a file a frame and the walls in a folder a run, and the mean fields of each.

    ParaView opens `grains.vtk.series` of a run as one time series, with the times since the opening [s], and beside it
    `walls.vtk`.

    Args:
        results: Results of the study.
        folder: Folder to write to.
        say: Function to call with the name of each run.

    Returns:
        Paths of the files.
    """
    paths = []
    for result in results.points:
        for run in result.runs:
            rows = run.frames()
            if rows is None or not len(rows["time"]):
                continue
            say(f"{result.label}, {run.repeat}")
            paths += _grains(result, rows, folder / file_name(result.point.index, run.seed, run.discharge))
        patterns = [("", pattern) for pattern in flow_patterns(result)[:1]]
        for kind, pattern in [*patterns, *kind_patterns(result).items()]:
            path = folder / f"point-{result.point.index + 1}-fields{kind and f'-{kind}'}.vtk"
            title = f"{results.study.name}, {result.label}: {kind and f'{kind}, '}means over {pattern.frames} frames"
            write_fields(path, title, pattern.fields)
            paths.append(path)
    return paths


def _grains(result: PointResult, rows, folder: Path) -> list[Path]:

    folder.mkdir(parents=True, exist_ok=True)
    scene, kinds = result.point.scene, kind_names(result.point.scene.grains)
    grains = scene.grains
    legend = f"; kinds: {', '.join(f'{k} {name}' for k, name in enumerate(kinds))}" if len(kinds) else ""
    order = np.argsort(rows["time"], kind="stable")
    times, starts = np.unique(np.asarray(rows["time"])[order], return_index=True)
    paths = []
    for number, (time, now) in enumerate(zip(times, np.split(order, starts[1:]), strict=True)):

        def columns(names: str, now=now) -> np.ndarray:
            return np.column_stack([np.asarray(rows[name], float)[now] for name in names.split()])

        x, vectors = columns("x y z"), {"velocity": columns("vx vy vz")}
        radius = np.asarray(rows["radius"], float)[now] if "radius" in rows else grains.diameter / 2
        numbers = {name: np.asarray(rows[name], int)[now] for name in ("id", "kind") if name in rows}
        rods = {}
        if isinstance(grains, Clumps):  # a point for each sphere
            q, spheres = columns("qw qx qy qz"), len(grains.spheres)
            vectors |= {"axis": axes(q), "first_axis": rotated(q, (1.0, 0.0, 0.0))}
            vectors, numbers = (
                {name: np.repeat(array, spheres, axis=0) for name, array in of.items()} for of in (vectors, numbers)
            )
            numbers["sphere"], radius = (
                np.tile(of, len(x)) for of in (np.arange(spheres), [sphere.radius for sphere in grains.spheres])
            )
            x = sphere_centres(grains, x, q)
        elif "qw" in rows:
            rods = {"axis": axes(columns("qw qx qy qz")), "length": getattr(grains, "length", None)}
        path = folder / f"grains-{number:04d}.vtk"
        write_grains(
            path,
            f"{result.label or 'the only point'}, t = {time:.6g} s{legend}",
            x,
            radius,
            vectors,
            numbers,
            **rods,
            kinds=kinds.tolist(),
        )
        paths.append(path)
    positions = np.column_stack([np.asarray(rows[axis], float) for axis in "xyz"])
    walls = folder / "walls.vtk"
    surfaces = list(drawn_walls(scene, positions))
    label = result.label or "the only point"
    write_walls(
        walls, f"walls: {', '.join(wall.name for wall in surfaces)}; {label}", {w.name: w.mesh for w in surfaces}
    )
    series = folder / "grains.vtk.series"
    write_series(series, paths, times)
    return [series, *paths, walls, *moving_walls(folder, surfaces, times, label)]


def moving_walls(folder: Path, surfaces: list[DrawnWall], times: np.ndarray, label: str) -> list[Path]:
    """Write all walls at each time and their series, if a part moves.

    Args:
        folder: Folder to write to.
        surfaces: Walls of the run.
        times: Times since the opening [s].
        label: Name of the run for the titles.

    Returns:
        Paths of the files; empty if no part moves.
    """
    if all(wall.part is None for wall in surfaces):
        return []
    paths = [folder / f"walls-{number:04d}.vtk" for number in range(len(times))]
    steps = zip(*(wall.at(times) for wall in surfaces), strict=True)
    for path, time, meshes in zip(paths, times, steps, strict=True):
        names = [wall.name for wall in surfaces]
        write_walls(path, f"walls, t = {time:.6g} s; {label}", dict(zip(names, meshes, strict=True)))
    series = folder / "walls.vtk.series"
    write_series(series, paths, times)
    return [series, *paths]
