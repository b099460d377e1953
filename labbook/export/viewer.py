"""Viewer of rerun: recordings in a window, or as a picture where there is no screen."""

import os
import socket
import subprocess
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from labbook.export.colour_bar import BACKGROUND
from labbook.export.entities import CLOCK, need_rerun
from labbook.export.flow_chart import FlowChart
from labbook.export.recording import flow_curves

SIZE = 1100, 1200
"""Width and height of the window of a screenshot in pixels."""
_HIDDEN = "NotFound"
_PATIENCE = 120.0  # s: to start, and to have drawn everything
_LATER = 0.5  # s between two looks
_LOOKS = 2  # in a row that have to show the same as the one before
_NOTICE = 4.0  # s: for two seconds the viewer says on which port it listens
_ORDER = {"3D": 0, "2D": 1}  # grains, the bar of their colours, then what else there is
_CURVES, _LOWEST = "TimeSeries", 130  # class of the view of W(t); pixels: least height of its picture
_HEAD = 28  # pixels: height of a line above a view


class ViewerFailed(Exception):
    """The viewer did not open or drew nothing; the message has its last words and a remedy."""


def show(recordings: Sequence[Path], at: float) -> None:
    """Open recordings in a window and wait until it is closed.

    Args:
        recordings: Recordings (.rrd).
        at: Time from which they play [s].

    Raises:
        ViewerMissing: rerun is not installed.
        ViewerFailed: The viewer did not open.
    """
    port = _free_port()
    command = [*viewer_command(), "--port", str(port), *map(str, recordings)]
    viewer = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=_plain())
    try:
        with suppress(RuntimeError, ConnectionError, TimeoutError):  # it then plays from the start
            _play_from(viewer, port, at)
        messages = viewer.communicate()[0]
    finally:
        viewer.terminate()
    if viewer.returncode:
        raise ViewerFailed(
            f"the viewer could not open a window; without a screen use --screenshot FILE or --no-open:\n"
            f"{_last_words(messages)}"
        )


def _play_from(viewer: subprocess.Popen, port: int, at: float) -> None:
    client = _connect(viewer, port)
    _extent(client, time.monotonic() + _PATIENCE)
    client.set_time(CLOCK, duration=at, play_state="playing")


def screenshot(recording: Path, picture: Path, at: float = 0.4, size: tuple[int, int] = SIZE) -> None:
    """Write a picture of the views that a recording opens with; needs no screen.

    The views stand below one another, without the viewer's own bars and panels. Each is headed by its name, the first
    by the time too.

    Args:
        recording: Recording (.rrd).
        picture: File to write (.png).
        at: Part of the run, from 0 to 1.
        size: Width and height of the window in pixels.

    Raises:
        ViewerMissing: rerun is not installed.
        ViewerFailed: The viewer drew nothing.
    """
    command, port = viewer_command(), _free_port()
    window = "x".join(map(str, size))
    command += ["--headless", "--port", str(port), "--hide-welcome-screen", "--window-size", window]
    # Not ViewerClient.spawn: a viewer that it starts listens on all addresses.
    viewer = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=_plain())
    try:
        with tempfile.TemporaryDirectory() as folder:
            rows = _photograph(viewer, port, recording.resolve(), Path(folder), at, size)
            picture.parent.mkdir(parents=True, exist_ok=True)
            _stack(rows, picture)
    except (RuntimeError, ConnectionError, TimeoutError) as error:
        viewer.terminate()
        output = _last_words(viewer.communicate(timeout=_PATIENCE)[0])
        raise ViewerFailed(
            f"the viewer drew no picture ({error}); without a GPU it needs a software Vulkan driver, such as "
            f"Debian's mesa-vulkan-drivers:\n{output}"
        ) from error
    finally:
        viewer.terminate()
        viewer.communicate(timeout=_PATIENCE)


def _photograph(
    viewer: subprocess.Popen, port: int, recording: Path, folder: Path, at: float, size: tuple[int, int]
) -> list[list[tuple[str, Path]]]:
    """Rows of pictures of all views, in `folder`, with what stands above them. W(t) is drawn here, since axes of the
    viewer are dark without a screen."""
    client = _connect(viewer, port)
    connected = time.monotonic()
    opened = client.open(str(recording))
    if not opened.store_ids and not opened.loading:
        raise RuntimeError(f"{recording} is not a recording that the viewer can read")
    deadline = connected + _PATIENCE
    start, end = _extent(client, deadline)
    now = start + at * (end - start)
    client.set_time(CLOCK, duration=now, play_state="paused")
    # What is drawn arrives bit by bit: pictures are complete when they no longer change. The first seconds show a
    # notice of the viewer's own besides.
    before, looks = b"", 0
    while looks < _LOOKS or time.monotonic() < connected + _NOTICE:
        _wait_until(deadline, "its picture keeps changing")
        views = sorted(client.get_state().views, key=lambda view: (_ORDER.get(view.view_class, len(_ORDER)), view.name))
        views = [view for view in views if view.view_class != _CURVES and _saved(client, view, folder)]
        paths = [folder / f"{view.view_id}.png" for view in views]
        pictures = b"".join(path.read_bytes() for path in paths)
        looks = looks + 1 if pictures == before else 0
        before = pictures
    complaints = [f"{view.name}: {report.summary}" for view in views for report in view.reports]
    if complaints:
        raise RuntimeError("; ".join(complaints))
    names = ["" if view.view_class == "2D" else view.name for view in views]  # colour bars speak for themselves
    names[0] += f"{', ' if names[0] else ''}t = {now:.3f} s"
    beds = [k for k, view in enumerate(views) if view.view_class == "3D"]
    rows = [[(names[k], paths[k]) for k in beds]] if beds else []
    rows += [[(names[k], paths[k])] for k in range(len(views)) if k not in beds]
    if curves := flow_curves(recording):
        chart = FlowChart(curves, end, size[0], max(_LOWEST, size[1] // 6)).with_mark(now)
        chart.save(folder / "flow.png")
        rows.append([("", folder / "flow.png")])
    return rows


def _saved(client, view, folder: Path) -> bool:
    """Save the picture of a view; False of one behind a tab, which has none."""
    try:
        client.save_screenshot(str(folder / f"{view.view_id}.png"), view_id=view.view_id)
    except (RuntimeError, ConnectionError) as error:
        if _HIDDEN not in str(error):
            raise
        return False
    return True


def _extent(client, deadline: float) -> tuple[float, float]:
    """First and last time [s] of the recording, once it is loaded. Raises TimeoutError."""
    state = client.get_state()
    while state.loading or not state.recordings or not state.recordings[0].timelines:
        _wait_until(deadline, "it is still loading")
        state = client.get_state()
    clock = next(timeline for timeline in state.recordings[0].timelines if timeline.name == CLOCK)
    return (clock.start or 0) * 1e-9, (clock.end or 0) * 1e-9  # nanoseconds


def _free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def _stack(rows: Sequence[Sequence[tuple[str, Path]]], picture: Path) -> None:
    """Put rows of pictures with lines of text above them (empty: none) below one another."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.image import imread

    pictures = [[(text, imread(path)) for text, path in row] for row in rows]
    heads = [_HEAD if any(text for text, _ in row) else 0 for row in pictures]
    width = max(sum(image.shape[1] for _, image in row) for row in pictures)
    highest = [max(image.shape[0] for _, image in row) for row in pictures]
    height = sum(heads) + sum(highest)
    figure = Figure((width / 100, height / 100), dpi=100, facecolor="#{:02x}{:02x}{:02x}".format(*BACKGROUND))
    FigureCanvasAgg(figure)
    top = height
    for head, high, row in zip(heads, highest, pictures, strict=True):
        left = 0
        for text, image in row:
            if text:
                figure.text((left + 10) / width, (top - head / 2) / height, text, fontsize=11, va="center")
            figure.figimage(image, left, top - head - image.shape[0])
            left += image.shape[1]
        top -= head + high
    figure.savefig(picture, dpi=100, facecolor=figure.get_facecolor())


def _connect(viewer: subprocess.Popen, port: int):
    from rerun.experimental import ViewerClient

    deadline = time.monotonic() + _PATIENCE
    while viewer.poll() is None:
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()
            return client
        except (RuntimeError, ConnectionError):
            _wait_until(deadline, "it does not answer")
    raise RuntimeError(f"it ended with status {viewer.returncode}")


def _wait_until(deadline: float, complaint: str) -> None:
    if time.monotonic() > deadline:
        raise TimeoutError(f"{complaint} after {_PATIENCE:g} s")
    time.sleep(_LATER)


def viewer_command() -> list[str]:
    """Command of the viewer, listening to this machine only; the `rerun` script on the PATH is a wrapper."""
    need_rerun()
    import rerun_cli

    return [str(Path(rerun_cli.__file__).with_name("rerun")), "--bind", "127.0.0.1"]


def _plain() -> dict[str, str]:
    """Environment that asks for messages without colours, and for errors only."""
    return {**os.environ, "NO_COLOR": "1", "RUST_LOG": "error"}


def _last_words(text: str) -> str:
    return "\n".join(text.strip().splitlines()[-3:])
