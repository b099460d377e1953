"""The embedded rerun viewer: its files from the installed wheel, recordings for it, and films.

All are cached in the user's cache folder: the viewer by version, recordings and films by run.
"""

import gzip
import os
import re
import socket
import subprocess
import threading
import time
import urllib.error
import urllib.request
from base64 import b64encode
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed_version
from pathlib import Path

from labbook.export.entities import CLOCK
from labbook.export.film import is_film_of, of_run, source_of_film
from labbook.export.frames import NotRecorded
from labbook.export.loop import loop_of_run, source_of_loop
from labbook.export.recording import middle_of, of_runs, path_of, recording_id
from labbook.export.viewer import viewer_command
from labbook.lab import RunRecord

FILES = {
    "index.html": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript; charset=utf-8",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
}
_TIMEOUT = 60.0  # s, for the viewer's own server to answer
_RETRY_INTERVAL = 0.1  # s between two attempts
_CACHE_SIZE = 60
"""Largest number of cached recordings, and of films; the least recently used are deleted first."""
_LOOPS = 600
"""Largest number of cached loops, of some 100 kB each."""
_NO_FRAMES = "the run kept no frames; to keep some, add `record: {every: 10 ms}` to the study and run it"
_KEY_DIGITS = 16  # digits of a key in the name of a file
_viewer_lock, _film_lock = threading.Lock(), threading.Lock()


class NoViewer(Exception):
    """Error for a viewer that is missing or does not start; the message has the remedy."""


def cache_folder() -> Path:
    """Folder of files that can be made again: in $LABBOOK_CACHE, or in labbook of the user's cache folder."""
    home = os.environ.get("LABBOOK_CACHE")
    if home:
        return Path(home) / "web"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "labbook" / "web"


def version() -> str:
    """Version of the installed viewer. Raises NoViewer."""
    try:
        return installed_version("rerun-sdk")
    except PackageNotFoundError:
        raise NoViewer("the viewer is not installed; install it: pip install 'labbook[viewer]'") from None


def viewer_files() -> Path:
    """Folder with the viewer's files, extracted at the first use of a version (some seconds). Raises NoViewer."""
    folder = cache_folder() / f"viewer-{version()}"
    with _viewer_lock:
        if not (folder / "complete").exists():
            _fetch(folder)
    return folder


def _fetch(folder: Path) -> None:
    """Download the files from the viewer's own server on this machine: the wheel embeds them in a program."""
    folder.mkdir(parents=True, exist_ok=True)
    web, data = _free_port(), _free_port()
    process = subprocess.Popen(
        [*viewer_command(), "--serve-web", "--port", str(data), "--web-viewer-port", str(web)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        for name in FILES:
            content = _get(f"http://127.0.0.1:{web}/{name}", process)
            if name == "index.html":
                content = _without_fonts(content)
            if name.endswith(".wasm"):
                (folder / f"{name}.length").write_text(str(len(content)))
                content, name = gzip.compress(content, 6), f"{name}.gz"
            (folder / name).write_bytes(content)
        (folder / "complete").touch()
    except (OSError, urllib.error.URLError) as error:
        raise NoViewer(f"the viewer does not serve its files: {error}") from error
    finally:
        process.terminate()
        process.wait(_TIMEOUT)


def _get(address: str, process: subprocess.Popen) -> bytes:
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    deadline = time.monotonic() + _TIMEOUT
    while True:
        try:
            with opener.open(address, timeout=_TIMEOUT) as answer:
                return answer.read()
        except urllib.error.HTTPError:
            raise
        except (urllib.error.URLError, ConnectionError):
            if process.poll() is not None or time.monotonic() > deadline:
                raise
            time.sleep(_RETRY_INTERVAL)


def _without_fonts(page: bytes) -> bytes:
    """Remove fonts of other machines from the viewer's page."""
    return re.sub(rb"<link[^>]+https?://[^>]+>|@import\s+url\([^)]*https?://[^)]*\);?", b"", page)


def recording(folders: Sequence[Path]) -> Path:
    """Path of a cached recording of runs, side by side on one clock; made at the first use.

    Args:
        folders: Folders of the runs.

    Returns:
        Recording (.rrd) for the installed version of the viewer.

    Raises:
        NotRecorded: A run without frames.
        Unreadable: A damaged run.
        ViewerMissing: The viewer is not installed.
    """
    for folder in folders:
        if RunRecord.read(folder).coverage.recording is None:
            raise NotRecorded(_NO_FRAMES)
    name = "-".join(folder.name[:_KEY_DIGITS] for folder in folders)
    path = cache_folder() / "recordings" / f"{name}-{recording_id('')}.rrd"
    with _viewer_lock:
        of_runs(folders, path)
        _evict(path.parent)
        os.utime(path)
    return path


def opening(folders: Sequence[Path]) -> str:
    """Encode the request that lets the viewer play from the middle of the window on, in base64.

    It is a message ViewerControlRequest of rerun's protocol, with a SetTimeCursorRequest.
    """
    instant = _field(3, _varint(1 << 3) + _varint(round(middle_of(folders) * 1e9)))
    cursor = _field(2, _field(1, CLOCK.encode())) + instant + _varint(5 << 3) + _varint(_PLAYING)
    return b64encode(_field(6, cursor)).decode("ascii")


_PLAYING = 2  # of rerun's enumeration PlayState


def _field(number: int, content: bytes) -> bytes:
    """Encode a length-delimited field (wire type 2) of Protocol Buffers."""
    return _varint(number << 3 | 2) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    """Encode a whole number as a varint of Protocol Buffers."""
    parts = bytearray()
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    return bytes([*parts, value])


def film(folder: Path) -> Path:
    """Path of the film (.webp) of a run: that of the lab, else a cached one, made at the first use.

    Args:
        folder: Folder of the run.

    Raises:
        NotRecorded: A run without frames.
        Unreadable: A damaged run.
    """
    if (path := stored_film(folder)) is not None:
        return path
    record = RunRecord.read(folder)
    if record.coverage.recording is None:
        raise NotRecorded(_NO_FRAMES)
    path = cache_folder() / "films" / f"{source_of_film(record)}.webp"
    with _film_lock:
        of_run(folder, path)
        _evict(path.parent, ".webp")
        os.utime(path)
    return path


def stored_film(folder: Path) -> Path | None:
    """Path of the film of a run in the lab; None without one. Raises Unreadable."""
    record = RunRecord.read(folder)
    path = path_of(folder.parents[1] / "films", record, None, None, "-layers.webp")
    return path if is_film_of(path, source_of_film(record)) else None


def loop(folder: Path) -> Path:
    """Path of the cached loop (.webp) of a run, made at the first use. Raises as `film`."""
    record = RunRecord.read(folder)
    if record.coverage.recording is None:
        raise NotRecorded(_NO_FRAMES)
    path = cache_folder() / "loops" / f"{source_of_loop(record)}.webp"
    with _film_lock:
        loop_of_run(folder, path)
        _evict(path.parent, ".webp", _LOOPS)
        os.utime(path)
    return path


def _evict(folder: Path, ending: str = ".rrd", limit: int = _CACHE_SIZE) -> None:
    files = sorted(folder.glob(f"*{ending}"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in files[limit:]:
        path.unlink(missing_ok=True)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
