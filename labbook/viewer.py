"""The rerun viewer: recordings in a window, or as a picture where there is no screen."""

import os
import socket
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from labbook.recording import CLOCK, need_rerun

_SIZE = "1280x900"
_PATIENCE = 60.0  # s: to start, and to have drawn everything
_LATER = 0.5  # s between two looks


class ViewerFailed(Exception):
    """The viewer did not open or drew nothing; the message has its last words and a remedy."""


def show(recordings: Sequence[Path]) -> None:
    """Open recordings (.rrd) in a window and wait until it is closed. Raises ViewerMissing or ViewerFailed."""
    command = [*_command(), "--port", "auto", *map(str, recordings)]
    done = subprocess.run(command, capture_output=True, text=True, env=_plain())
    if done.returncode:
        raise ViewerFailed(
            f"the viewer could not open a window; without a screen use --screenshot FILE or --no-open:\n"
            f"{_last_words(done.stderr or done.stdout)}"
        )


def screenshot(recording: Path, picture: Path, at: float = 0.4) -> None:
    """Write to `picture` (.png) what the viewer shows at the fraction `at` of a recording; needs no screen.

    Raises ViewerMissing or ViewerFailed.
    """
    command = _command()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command += ["--headless", "--port", str(port), "--hide-welcome-screen", "--window-size", _SIZE]
    # Not ViewerClient.spawn: a viewer that it starts listens on all addresses.
    viewer = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=_plain())
    try:
        _photograph(viewer, port, recording.resolve(), picture.resolve(), at)
    except (RuntimeError, ConnectionError, TimeoutError) as error:
        viewer.terminate()
        said = _last_words(viewer.communicate(timeout=_PATIENCE)[0])
        raise ViewerFailed(
            f"the viewer drew no picture ({error}); without a GPU it needs a software Vulkan driver, such as "
            f"Debian's mesa-vulkan-drivers:\n{said}"
        ) from error
    finally:
        viewer.terminate()
        viewer.communicate(timeout=_PATIENCE)


def _photograph(viewer: subprocess.Popen, port: int, recording: Path, picture: Path, at: float) -> None:
    client = _connect(viewer, port)
    opened = client.open(str(recording))
    if not opened.store_ids and not opened.loading:
        raise RuntimeError(f"{recording} is no recording that it can read")
    deadline = time.monotonic() + _PATIENCE
    state = client.get_state()
    while state.loading or not state.recordings or not state.recordings[0].timelines:
        _wait_until(deadline, "it is still loading")
        state = client.get_state()
    clock = next(timeline for timeline in state.recordings[0].timelines if timeline.name == CLOCK)
    start, end = clock.start or 0, clock.end or 0  # nanoseconds
    client.set_time(CLOCK, duration=(start + at * (end - start)) * 1e-9, play_state="paused")
    picture.parent.mkdir(parents=True, exist_ok=True)
    # What is drawn arrives bit by bit: the picture is complete when it no longer changes.
    before = b""
    while True:
        client.save_screenshot(str(picture))
        now = picture.read_bytes()
        if now == before:
            return
        before = now
        _wait_until(deadline, "its picture keeps changing")


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


def _command() -> list[str]:
    """The viewer's binary, listening to this machine only; the `rerun` script on the PATH is a wrapper."""
    need_rerun()
    import rerun_cli

    return [str(Path(rerun_cli.__file__).with_name("rerun")), "--bind", "127.0.0.1"]


def _plain() -> dict[str, str]:
    """The environment, asking for messages without colours and without what does not matter."""
    return {**os.environ, "NO_COLOR": "1", "RUST_LOG": "error"}


def _last_words(text: str) -> str:
    return "\n".join(text.strip().splitlines()[-3:])
