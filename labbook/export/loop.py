"""Loops: a bed in motion without any writing, for cards that show many beds side by side."""

from io import BytesIO
from pathlib import Path

import numpy as np

from labbook.export.film import Camera, Shot, is_film_of, shot_of_run, source_of_film
from labbook.lab import RunRecord
from labbook.lab.folder import write_bytes

VERSION = 1
"""Version of loops, raised when older ones are stale."""
SECONDS, SIZE = 4.0, 160
"""Duration of a loop [s], and pixels of the longer side of its bed."""
FRAMES = 32
"""Largest number of frames of a loop."""
_QUALITY, _EDGES = 50, 20  # of WebP, and of its transparency: grains of few pixels in motion


def loop_of_run(folder: Path, path: Path) -> Path:
    """Make the loop of a recorded run, unless it is there.

    Args:
        folder: Folder of the run.
        path: File to write (.webp).

    Returns:
        `path`.

    Raises:
        Unreadable: Files of the run are damaged.
        NotRecorded: The run kept no frames.
    """
    source = source_of_loop(RunRecord.read(folder))
    if not is_film_of(path, source):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, encoded(shot_of_run(folder, "layers"), source=source), durable=False)
    return path


def source_of_loop(record: RunRecord) -> str:
    """Source of a loop: the run and the version of the drawing."""
    return f"{source_of_film(record)}-loop-{VERSION}"


def encoded(shot: Shot, *, seconds: float = SECONDS, size: int = SIZE, frames: int = FRAMES, source: str = "") -> bytes:
    """Draw a loop of a run.

    Args:
        shot: The run.
        seconds: Duration [s].
        size: Pixels of the longer side.
        frames: Largest number of frames.
        source: Text that is kept in the file, by which `labbook.export.film.is_film_of` knows the run again.

    Returns:
        WebP without end, transparent around bed and walls, so that it fits a light and a dark page.
    """
    from PIL import Image

    camera = Camera(shot, size)
    clock = np.array([frame.time for frame in shot.frames])
    times = np.linspace(0, shot.end, max(2, min(int(np.sum(clock <= shot.end)), frames)))
    frame_indices = np.maximum(np.searchsorted(clock, times * (1 + 1e-9), side="right") - 1, 0)
    pictures = [Image.fromarray(camera.rgba(shot.frames[k])) for k in frame_indices]
    stored, interval = BytesIO(), round(1000 * seconds / len(times))
    pictures[0].save(
        stored, "WEBP", save_all=True, append_images=pictures[1:], duration=interval, loop=0, quality=_QUALITY,
        alpha_quality=_EDGES, method=4, xmp=source.encode(),
    )  # fmt: skip
    return stored.getvalue()
