"""Recordings of finished runs for the rerun viewer: grains, walls, contact forces, and W(t) on the same clock.

Tabs show the same grains by layers, by speed, by orientation, and with velocities, paths and contact forces, and the
mean flow over the window. By speed, grains of several kinds have a colour a kind, the lighter the faster; a bar below
them says which colour is what. Several runs stand side by side in one recording, on one clock.

rerun is imported only in this room, and only when a recording is made or shown.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labbook.export.entities import (
    CLOCK,
    Steady,
    log_grains,
    log_mean_flow,
    need_rerun,
    send_flow_rate,
    send_forces,
    send_paths,
    send_velocities,
)
from labbook.export.flow_chart import FlowCurve
from labbook.export.forces import PairForces, forces_of
from labbook.export.frames import FRAMES, Frame, frames_of_run, top_speed
from labbook.export.views import above_bar, flow_rate_view, front_view, log_bars, playing
from labbook.lab import RunRecord
from labbook.lab.evaluations import evaluate, stored
from labbook.lab.runs import read_recording, run_data
from labbook.measure import MEASURES, RunData
from labbook.measure.flow import Trace
from labbook.measure.recorded import Bed, FlowPattern
from labbook.measure.series import flow_curve
from labbook.study import Point

VERSION = 5
"""Version of recordings, raised when older ones are stale."""
POSITIONS = 4_000_000
"""Largest number of positions in all frames of a recording, if these are more than FRAMES frames.

A position takes up to 20 bytes, of rods 40, without forces. Of more frames every second, third ... is shown."""
FORCES = 400_000
"""Largest number of positions in a recording with contact forces: computing them takes some seconds."""

SIDE_BY_SIDE = 4
"""Largest number of runs side by side."""


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """Run of a recording.

    Attributes:
        data: The run.
        frames: Its frames, by time.
        name: Title in the viewer.
        steady: Window and mean of its flow rate; None without.
        mean_flow: Mean fields over the window; None without.
        forces: Contact forces in a frame; None: none are shown.
    """

    data: RunData
    frames: Sequence[Frame]
    name: str
    steady: Steady | None = None
    mean_flow: Bed | None = None
    forces: Callable[[Frame], PairForces] | None = None

    @classmethod
    def of(cls, data: RunData, sample: Mapping[str, np.ndarray] | None, name: str, **attributes: Any) -> "RecordedRun":
        """Make a run ready for a recording.

        Contact forces are left out where there are more than FORCES positions of grains in all frames.

        Args:
            data: Run.
            sample: Its recorded frames, columns id, time, x, y, z, vx, vy, vz as the probe `Film` lists them.
            name: Name of the run in the viewer.
            attributes: All other attributes.

        Returns:
            Run with its frames.

        Raises:
            NotRecorded: The run kept no frames.
        """
        frames = frames_of_run(data, sample, max(FRAMES, POSITIONS // data.scene.grains.count))
        if sum(len(frame.ids) for frame in frames) > FORCES:
            attributes["forces"] = None
        return cls(data, frames, name, **attributes)

    @classmethod
    def read(cls, folder: Path, record: RunRecord, name: str) -> "RecordedRun":
        """Read a finished run.

        Args:
            folder: Folder of the run.
            record: Its record.
            name: Name of the run in the viewer.

        Returns:
            Run with its frames.

        Raises:
            Unreadable: Files of the run are damaged.
            NotRecorded: The run kept no frames.
        """
        data = run_data(folder, record)
        return cls.of(
            data, read_recording(folder, record), name, steady=steady_of(folder, record),
            mean_flow=_mean_flow(record, data), forces=forces_of(record.backend, data),
        )  # fmt: skip


def steady_of(folder: Path, record: RunRecord) -> Steady | None:
    """Read window and mean of the flow rate, as evaluated when the run ended.

    Args:
        folder: Folder of the run.
        record: Its record.

    Returns:
        Window and mean; None if either is missing.
    """
    result = stored(folder, MEASURES["flow_rate"], record.observe)
    trace = None if result is None else Trace.of(result.evaluation)
    if result is None or trace is None or trace.window is None:
        return None
    rate = next((one for one in result.evaluation.numbers if one.quantity == "flow_rate"), None)
    if rate is None or not np.isfinite(rate.value):
        return None
    return Steady(*trace.window, rate.value * 1e3, rate.error * 1e3)


def middle_of(folders: Sequence[Path]) -> float:
    """Find the time at which a viewer begins to play.

    Args:
        folders: Folders of finished runs.

    Returns:
        Middle of the window of the first run that has one, else of the first run [s].

    Raises:
        Unreadable: Files of a run are damaged.
    """
    records = [(folder, RunRecord.read(folder)) for folder in folders]
    windows = [steady for folder, record in records if (steady := steady_of(folder, record)) is not None]
    return (windows[0].begin + windows[0].end) / 2 if windows else records[0][1].coverage.duration / 2


def _mean_flow(record: RunRecord, data: RunData) -> Bed | None:
    """Mean fields over the window; None where there are too few frames, or Numba is missing."""
    try:
        return Bed.of(evaluate(FlowPattern(), record.observe, data).evaluation)
    except ImportError:
        return None


def file_name(point: int, seed: int, discharge: int = 1) -> str:
    """Name the files of a run.

    Args:
        point: Index of the point, from 0.
        seed: Seed.
        discharge: Number of the discharge, from 1.

    Returns:
        Name without an ending, such as `point-1-seed-1`.
    """
    return f"point-{point + 1}-seed-{seed}" + (f"-discharge-{discharge}" if discharge > 1 else "")


def of_run(folder: Path, lab: Path, study: str | None = None, point: Point | None = None) -> Path:
    """Make the recording of a finished run, lab/recordings/STUDY/point-1-seed-1-BACKEND.rrd, unless it is there.

    It is made again if a recording of another run or of an older version has that name.

    Args:
        folder: Folder of the run.
        lab: Folder of the lab.
        study: Study for which the run is shown; None: for which it was made.
        point: Point of that study.

    Returns:
        Path of the recording.

    Raises:
        Unreadable: Files of the run are damaged.
        NotRecorded: The run kept no frames.
        ViewerMissing: rerun is not installed.
    """
    record = RunRecord.read(folder)
    path = path_of(lab / "recordings", record, study, point, ".rrd")
    source = recorded_from(folder, record)
    if holds(path, source):
        return path
    return write([RecordedRun.read(folder, record, titled(record, study, point))], path, source)


def of_runs(folders: Sequence[Path], path: Path) -> Path:
    """Make the recording of several finished runs side by side on one clock, unless it is there.

    Args:
        folders: Folders of the runs.
        path: File to write (.rrd).

    Returns:
        `path`.

    Raises:
        Unreadable: Files of a run are damaged.
        NotRecorded: A run kept no frames.
        ViewerMissing: rerun is not installed.
    """
    records = [RunRecord.read(folder) for folder in folders]
    source = "+".join(recorded_from(folder, record) for folder, record in zip(folders, records, strict=True))
    if holds(path, source):
        return path
    runs = [RecordedRun.read(*run, titled(run[1])) for run in zip(folders, records, strict=True)]
    return write(runs, path, source)


def path_of(folder: Path, record: RunRecord, study: str | None, point: Point | None, ending: str) -> Path:
    """Name the file of a recording or a film of a run, FOLDER/STUDY/point-1-seed-1-BACKEND and an ending.

    Args:
        folder: Folder of all recordings or films.
        record: Record of the run.
        study: Study for which the run is shown; None: for which it was made.
        point: Point of that study.
        ending: Ending of the name, with its dot.

    Returns:
        Path of the file.
    """
    index = record.point if point is None else point.index
    name = f"{file_name(index, record.seed, record.discharge)}-{record.backend}{ending}"
    return folder / (study or record.study) / name


def titled(record: RunRecord, study: str | None = None, point: Point | None = None) -> str:
    """Title of a run, `rods: rotation 0.5 Hz, seed 1`; study, point: as of `path_of`."""
    at, label = (record.at, record.label) if point is None else (point.at, point.label)
    return f"{study or record.study}: {f'{label}, ' if at else ''}{record.repeat}"


def source_of(record: RunRecord) -> str:
    """Source of a film or a recording of a run: the run, how far it went, and the time between its frames."""
    coverage = record.coverage
    return f"{record.run_key}-{coverage.steps}-{coverage.frame_interval or 0:g}"


def recorded_from(folder: Path, record: RunRecord) -> str:
    """Source of a recording of the run in `folder`: `source_of` with the window that it marks."""
    steady = steady_of(folder, record)
    return source_of(record) + (f"-{steady.begin:.6g}-{steady.end:.6g}" if steady is not None else "")


def holds(path: Path, source: str) -> bool:
    """Compare a file with the recording that would be written now.

    Args:
        path: File, which need not exist.
        source: Source of the recording (`recorded_from`).

    Returns:
        True if the file is a whole recording from that source by this version.

    Raises:
        ViewerMissing: rerun is not installed.
    """
    identity = recording_id(source)
    if not path.exists():
        return False
    from rerun.chunk import RrdReader

    try:
        return [entry.recording_id for entry in RrdReader(path).recordings()] == [identity]
    except (RuntimeError, OSError):  # it is no recording, or not all of one: written again
        return False


def recording_id(source: str) -> str:
    """Name the source of a recording inside its file.

    Only the viewer's own and the next minor version are promised to read it, so the version is a part of the name.

    Args:
        source: Source of the recording (`recorded_from`).

    Returns:
        Identity of the recording.

    Raises:
        ViewerMissing: rerun is not installed.
    """
    minor = ".".join(need_rerun().__version__.split(".")[:2])
    return f"{source}-{VERSION}-rerun-{minor}"


def write(runs: Sequence[RecordedRun], path: Path, source: str, opens: str = "layers") -> Path:
    """Write the recording of runs, side by side where there are several, in place by one rename.

    Args:
        runs: Runs with their frames.
        path: File to write (.rrd).
        source: Source of the recording (`recorded_from`).
        opens: Name of the tab in front.

    Returns:
        `path`.

    Raises:
        ViewerMissing: rerun is not installed.
    """
    need_rerun()
    import rerun.blueprint as rrb

    roots = [f"run-{number + 1}" if len(runs) > 1 else "" for number in range(len(runs))]
    fastest = max(top_speed(run.data.scene, run.frames) for run in runs)
    curves = {root: curve for root, run in zip(roots, runs, strict=True) if (curve := flow_curve(run.data)) is not None}
    front = rrb.Tabs(*_tabs(runs, roots).values(), active_tab=[*_tabs_of(runs)].index(opens), name=_title(runs))
    window = runs[0].steady if len(runs) == 1 else None
    below = [flow_rate_view([*curves], "" if window is None else window.mean)] if curves else []
    layout = rrb.Vertical(front, *below, row_shares=[10, *(2 + len(runs) for _ in below)])
    marked = None if window is None else (window.begin, window.end)
    lasts = max(run.data.duration for run in runs)
    with rrd_stream(path, _title(runs), recording_id(source), layout, lasts, marked) as stream:
        for number, (root, run) in enumerate(zip(roots, runs, strict=True)):
            _send(stream, root, run, fastest)
            if root in curves:
                name = run.name if len(runs) > 1 else "W(t)"
                send_flow_rate(stream, root, curves[root], run.steady, name, number)
        log_bars(stream, runs[0].data.scene, fastest)
    return path


def _title(runs: Sequence[RecordedRun]) -> str:
    return " beside ".join(run.name for run in runs)


def _send(stream, root: str, run: RecordedRun, fastest: float) -> None:
    """Send the entities of a run below `root`."""
    scene, frames = run.data.scene, run.frames
    log_grains(stream, root, scene, run.data.start, frames, fastest)
    send_velocities(stream, root, scene, frames, fastest)
    send_paths(stream, root, scene, run.data.start, frames)
    if run.mean_flow is not None:
        log_mean_flow(stream, root, run.mean_flow, fastest)
    if run.forces is not None:
        send_forces(stream, root, [frame.time for frame in frames], [run.forces(frame) for frame in frames], scene)


def _tabs_of(runs: Sequence[RecordedRun]) -> dict[str, str]:
    """Names of tabs, with what `front_view` shows grains by; those that all runs have."""
    tabs = {"layers": "layers", "speed": "speed", "velocities": "velocities", "paths": "paths"}
    if all(run.data.scene.grains.elongated for run in runs):
        tabs["orientation"] = "orientation"
    if all(run.forces is not None for run in runs):
        tabs["forces"] = "forces"
    if all(run.mean_flow is not None for run in runs):
        tabs["mean flow"] = "mean_flow"
    return tabs


def _tabs(runs: Sequence[RecordedRun], roots: Sequence[str]) -> dict[str, Any]:
    """Views of all runs by the names of their tabs, above a bar where colours are speeds."""
    import rerun.blueprint as rrb

    tabs = {}
    for name, by in _tabs_of(runs).items():
        views = [
            front_view(run.data.scene, run.frames, origin=root, name=run.name if len(runs) > 1 else name, by=by)
            for root, run in zip(roots, runs, strict=True)
        ]
        view = views[0] if len(views) == 1 else rrb.Horizontal(*views, name=name)
        if by in ("speed", "velocities", "mean_flow"):
            view = above_bar(view, runs[0].data.scene, name, plain=by != "speed")
        tabs[name] = view
    return tabs


def flow_curves(path: Path) -> list[FlowCurve]:
    """Read the curves W(t) of a recording.

    Args:
        path: Recording (.rrd).

    Returns:
        Curves with their names and windows.
    """
    need_rerun()
    from rerun.chunk import RrdReader

    rows: dict[str, list[tuple[int, float]]] = {}
    names: dict[str, str] = {}
    for chunk in RrdReader(path).stream():
        if not chunk.entity_path.removesuffix(_WINDOW).endswith("flow_rate"):
            continue
        table = chunk.to_record_batch().to_pydict()
        if chunk.is_static:
            names[chunk.entity_path] = table["SeriesLines:names"][0][0]
            continue
        values = [value for (value,) in table["Scalars:scalars"]]
        times = [time.value for time in chunk.to_record_batch().column(CLOCK)]
        rows.setdefault(chunk.entity_path, []).extend(zip(times, values, strict=True))
    curves = []
    for entity in sorted(name for name in rows if not name.endswith(_WINDOW)):
        time, rate = np.array(sorted(rows[entity])).T
        window = rows.get(f"{entity}{_WINDOW}")
        ends = None if window is None else (min(window)[0] * 1e-9, max(window)[0] * 1e-9)
        curves.append(FlowCurve(time * 1e-9, rate, names.get(entity, ""), ends))
    return curves


_WINDOW = "/window"


@contextmanager
def rrd_stream(
    path: Path, name: str, identity: str, layout, duration: float, window: tuple[float, float] | None = None
) -> Iterator[Any]:
    """Open a stream of rerun; at its end the file is put in place by one rename.

    Args:
        path: File to write (.rrd).
        name: Name in the viewer.
        identity: Identity of the recording (`recording_id`).
        layout: Layout of the views.
        duration: Duration of the run [s].
        window: Times [s] that are marked on the clock.

    Yields:
        Stream of rerun.

    Raises:
        ViewerMissing: rerun is not installed.
    """
    rr = need_rerun()
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    path.parent.mkdir(parents=True, exist_ok=True)
    stream = rr.RecordingStream("labbook", recording_id=identity)
    try:
        stream.save(partial, default_blueprint=playing(layout, duration, window))
        stream.send_recording_name(name)
        yield stream
        stream.flush()
        stream.disconnect()
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
