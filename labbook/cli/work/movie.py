"""Films of runs and of sweeps, with what was written in a line each."""

from pathlib import Path

from labbook.backend import BackendMissing
from labbook.cli.options import fail
from labbook.cli.screen import say
from labbook.cli.work.recorded import Recorded, of_recorded
from labbook.export.colouring import NoColouring
from labbook.export.film import SIZE, TILE, FilmFile, NoFilm, Shot, check, film, of_sweep, shot_of_run, source_of_sweep
from labbook.export.forces import NoForces
from labbook.export.frames import NotRecorded
from labbook.export.recording import path_of
from labbook.lab import NoCatalogue, RunRecord, Unreadable
from labbook.study import Point


def movie(
    target: str, point: int | None, colour: str, grid: bool, seconds: float, size: int | None, out: Path | None,
    lab: Path, backend: str,
) -> None:  # fmt: skip
    """Film the recorded runs of a study or a run."""
    if grid and not Path(target).is_file():
        fail(f"--grid: {target} is no study file; a sweep is that of a study")
    try:
        if out is not None:
            check(out)
        runs = of_recorded(target, point, lab, backend, lambda run: (run, RunRecord.read(run.folder)))
        if grid:
            _sweep(runs, colour, seconds, size or TILE, out, lab)
            return
        if out is not None and len(runs) > 1:
            fail(f"--out: {target} has {len(runs)} recorded runs; choose one with --point or by its key, or add --grid")
        for run, record in runs:
            path = out or path_of(lab / "films", record, run.study, run.point, f"-{colour}.webp")
            shot = shot_of_run(run.folder, colour, run.study, run.point)
            _say(film(shot, path, seconds=seconds, size=size or SIZE), shot)
    except (NoCatalogue, Unreadable, NotRecorded, NoColouring, NoForces, NoFilm, BackendMissing) as error:
        fail(error)


def _sweep(
    runs: list[tuple[Recorded, RunRecord]], colour: str, seconds: float, size: int, out: Path | None, lab: Path
) -> None:  # fmt: skip
    """One film of the first recorded run of each point."""
    first = dict[int, tuple[Recorded, Point]]()
    for run, _ in runs:
        if run.point is not None:
            first.setdefault(run.point.index, (run, run.point))
    record, name = runs[0][1], str(runs[0][0].study)
    shots = [(point.at, shot_of_run(run.folder, colour, name, point)) for run, point in first.values()]
    path = out or lab / "films" / name / f"sweep-{record.backend}-{colour}.webp"
    source = source_of_sweep([RunRecord.read(run.folder) for run, _ in first.values()])
    _say(
        of_sweep(shots, path, seconds=seconds, size=size, source=source),
        max((shot for _, shot in shots), key=lambda shot: len(shot.frames)),
    )


def _say(film: FilmFile, shot: Shot) -> None:
    width, height = film.pixels
    size = film.path.stat().st_size / 1e6
    say(f"Film: {film.path} ({film.frames} frames, {film.seconds:g} s, {width} x {height}, {size:.2g} MB)")
    if film.frames / film.seconds < _FLUENT:
        rate, every = film.frames / film.seconds, shot.end / (_FLUENT * film.seconds)
        say(f"  {rate:.2g} frames a second: record: {{every: {1e3 * every:.2g} ms}} makes it flow, or fewer --seconds")


_FLUENT = 12.0
"""Frames a second from which on motion is seen, and no steps."""
