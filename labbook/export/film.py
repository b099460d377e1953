"""Films of recorded runs: the grains with their walls, W(t) beside them, or a whole sweep in rows and columns.

Frames are drawn by `labbook.picture` and written by Pillow (WebP, GIF), or by ffmpeg where it is installed (MP4).
"""

import hashlib
import math
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from importlib import import_module
from importlib.util import find_spec
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from labbook.backend import load_to_plan
from labbook.export.colour_bar import BACKGROUND
from labbook.export.colouring import Colouring, Legend, force_colours
from labbook.export.flow_chart import QUIET, FlowChart, FlowCurve
from labbook.export.forces import PairForces, packing_of, pair_forces, scale_of
from labbook.export.frames import Frame, frames_of_run
from labbook.export.recording import source_of, steady_of, titled
from labbook.export.wall_shapes import DrawnWall, drawn_walls
from labbook.lab import RunRecord
from labbook.lab.folder import write_bytes
from labbook.lab.runs import read_recording, run_data
from labbook.measure import RunData
from labbook.measure.series import flow_curve
from labbook.picture import Raster, Strokes, front, render
from labbook.results import display
from labbook.results.placement import placement
from labbook.scene import Packing, Scene
from labbook.scene.geometry import Segment
from labbook.study import Point

if TYPE_CHECKING:
    from PIL.Image import Image

VERSION = 2
"""Version of films, raised when older ones are stale."""
SECONDS, SIZE, TILE = 6.0, 480, 200
"""Default duration of a film [s], and pixels of the longer side of a bed, alone and in a sweep."""
FORMATS = (".webp", ".gif", ".mp4")
"""Endings of the names of films."""
_RATE = 25
"""Largest number of frames a second."""
_INK = (38, 44, 54)
_SPOKE = np.array((213, 94, 0)) / 255
_SECTORS = 8
_MARK = 4.0  # pixels: width of marks of a turning bottom
_FAINT, _THINNEST, _WIDEST = 0.02, 0.7, 0.4  # of forces: least part of the scale; width in pixels, and in diameters
_STROKE_FIELDS = ("ends", "width", "colour")
_SCALED = 12  # frames by which a scale of forces is chosen
_SMALL = 11  # pixels: size of the type below a bed of a sweep
_PAD, _LINE, _BAR = 12, 22, 40  # pixels: around everything, of a line of text, of a legend
_CHART = (340, 230)  # pixels beside an upright bed
_LOW = 140  # pixels: height of a chart below a wide bed
_NARROWEST = 200  # pixels: of a film without a chart, for its heading
_FINE = 2  # points along x and z that a pixel is the mean of: in motion finer ones are not seen
_QUALITY = 70  # of WebP
_PALETTE = 128  # colours of a GIF


class NoFilm(Exception):
    """A film cannot be made; the message says why and what to do."""


class Shot(NamedTuple):
    """A run to film.

    Attributes:
        data: The run.
        frames: Its frames, by time.
        colouring: Colours of its grains.
        title: Heading of its picture.
        forces: Contact forces in a frame, which are drawn as lines; None: none are.
        window: Begin and end [s] of the window of W, shaded on W(t); None without.
    """

    data: RunData
    frames: Sequence[Frame]
    colouring: Colouring
    title: str
    forces: Callable[[Frame], PairForces] | None = None
    window: tuple[float, float] | None = None

    @classmethod
    def of(
        cls, data: RunData, sample: Mapping[str, np.ndarray] | None, by: str, title: str, backend: str,
        window: tuple[float, float] | None = None,
    ) -> "Shot":  # fmt: skip
        """Make a run ready for a film.

        Args:
            data: Run.
            sample: Its recorded frames (`read_recording`).
            by: Property that grains are coloured by.
            title: Heading of the picture.
            backend: Name of the backend that made the run.
            window: Begin and end of the window of W [s].

        Returns:
            Run with its frames and colours.

        Raises:
            NotRecorded: The run kept no frames.
            NoColouring: The grains do not have that property.
            NoForces: The backend does not tell contact forces.
            BackendMissing: The backend is not installed.
        """
        frames, forces, top = frames_of_run(data, sample, _LIMIT), None, 0.0
        if by == "force":
            made_by = load_to_plan(backend)
            forces = partial(pair_forces, made_by, data.scene, data.numerics, data.start)
            top = scale_of([forces(frame) for frame in frames[:: -(-len(frames) // _SCALED)]])
        return cls(data, frames, Colouring.of(by, data.scene, data.start, frames, top), title, forces, window)

    @property
    def end(self) -> float:
        """End of a film of it [s]: the time of its last frame, of a clogged run soon after its last grain."""
        last = self.frames[-1].time
        if self.data.outcome != "clogged":
            return last
        return min(last, max(_REST * self.stopped, self.frames[min(_FEWEST, len(self.frames) - 1)].time))

    @property
    def stopped(self) -> float:
        """Time [s] of the last grain of a clogged run, of others the end."""
        if self.data.outcome != "clogged" or "crossing" not in self.data.tables:
            return self.data.duration
        return float(np.max(self.data.tables["crossing"]["time"], initial=0.0))


_REST, _FEWEST = 1.25, 20  # of a clogged run: end over the time of its last grain, and frames at least
_LIMIT = 2000  # frames of a run among which a film chooses


class FilmFile(NamedTuple):
    """File of a film.

    Attributes:
        path: File.
        frames: Number of frames.
        pixels: Width and height.
        seconds: Duration [s].
    """

    path: Path
    frames: int
    pixels: tuple[int, int]
    seconds: float


def film(
    shot: Shot, path: Path, *, seconds: float = SECONDS, size: int = SIZE, source: str = ""
) -> FilmFile:  # fmt: skip
    """Write a film of one run, with W(t) where grains leave.

    Args:
        shot: The run.
        path: File to write, with an ending among FORMATS.
        seconds: Duration of the film.
        size: Pixels of the longer side of the picture of the bed.
        source: Text that is kept in a WebP, by which `is_film_of` knows the run again.

    Raises:
        NoFilm: The format is unknown or needs an encoder that is not installed.
    """
    check(path)
    times = _times([shot], seconds)
    return _write(_run_frames(Camera(shot, size), times), path, seconds, source)


def sweep_film(
    rows: Sequence[str], columns: Sequence[str], shots: Mapping[tuple[int, int], Shot], path: Path, *,
    seconds: float = SECONDS, size: int = TILE, source: str = "",
) -> FilmFile:  # fmt: skip
    """Write a film of several runs on one clock, in rows and columns.

    Args:
        rows: Headings of the rows, empty ones where there is one row only.
        columns: Headings of the columns.
        shots: Runs by row and column.
        path: File to write, with an ending among FORMATS.
        seconds: Duration of the film.
        size: Pixels of the longer side of each picture of a bed.
        source: As of `film`.

    Raises:
        NoFilm: As of `film`.
    """
    check(path)
    times = _times(list(shots.values()), seconds)
    cameras = {cell: Camera(shot, size) for cell, shot in shots.items()}
    return _write(_sweep_frames(rows, columns, cameras, times), path, seconds, source)


def of_run(folder: Path, path: Path, study: str | None = None, point: Point | None = None) -> Path:
    """Make the film of a recorded run with its layers, unless it is there.

    Args:
        folder: Folder of the run.
        path: File to write (.webp).
        study: Study for which the run is shown; None: for which it was made.
        point: Point of that study.

    Returns:
        `path`.

    Raises:
        Unreadable: Files of the run are damaged.
        NotRecorded: The run kept no frames.
    """
    source = source_of_film(RunRecord.read(folder))
    if not is_film_of(path, source):
        film(shot_of_run(folder, "layers", study, point), path, source=source)
    return path


def source_of_film(record: RunRecord) -> str:
    """Source of a film: the run and the version of the drawing."""
    return f"{source_of(record)}-film-{VERSION}"


def source_of_sweep(records: Sequence[RunRecord]) -> str:
    """Source of a film of a sweep: the runs and the version of the drawing."""
    return hashlib.blake2b("+".join(map(source_of_film, records)).encode(), digest_size=16).hexdigest()


def is_film_of(path: Path, source: str) -> bool:
    """True if the file is a film of this source."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            return image.info.get("xmp") == source.encode()
    except (OSError, SyntaxError, ValueError):
        return False


def shot_of_run(folder: Path, by: str, study: str | None = None, point: Point | None = None) -> Shot:
    """Read a recorded run for a film.

    Args:
        folder: Folder of the run.
        by: Property that grains are coloured by.
        study: Study for which the run is shown; None: for which it was made.
        point: Point of that study.

    Returns:
        Run with its frames and colours.

    Raises:
        Unreadable: Files of the run are damaged.
        NotRecorded, NoColouring, NoForces, BackendMissing: As of `Shot.of`.
    """
    record = RunRecord.read(folder)
    steady = steady_of(folder, record)
    return Shot.of(
        run_data(folder, record), read_recording(folder, record), by, titled(record, study, point), record.backend,
        None if steady is None else (steady.begin, steady.end),
    )  # fmt: skip


def of_sweep(
    shots: Sequence[tuple[Mapping[str, float | str], Shot]], path: Path, *, seconds: float = SECONDS, size: int = TILE,
    source: str = "",
) -> FilmFile:  # fmt: skip
    """Write a film of a sweep: columns by the key with most values, rows by all others.

    Args:
        shots: Runs with the values of their swept keys [SI].
        path: File to write, with an ending among FORMATS.
        seconds: Duration of the film [s].
        size: Pixels of the longer side of each picture of a bed.
        source: As of `film`.

    Returns:
        File of the film.

    Raises:
        NoFilm: As of `film`.
    """
    layout = placement([at for at, _ in shots], row_keys=None)
    columns = [display.setting(layout.column, value) if value is not None else "" for value in layout.columns]
    rows = [
        display.label({key: value for key, value in zip(layout.row, row, strict=True) if value is not None})
        for row in layout.rows
    ]
    runs = {cell: shots[k][1] for cell, k in layout.points.items()}
    return sweep_film(rows, columns, runs, path, seconds=seconds, size=size, source=source)


def check(path: Path) -> None:
    """Refuse a file whose format cannot be written here.

    Args:
        path: File to write.

    Raises:
        NoFilm: The format is unknown or needs an encoder that is not installed.
    """
    if path.suffix.lower() not in FORMATS:
        raise NoFilm(f"{path.name}: no film has the ending {path.suffix or 'of nothing'}; use {', '.join(FORMATS)}")
    if path.suffix.lower() == ".mp4" and encoder() is None:
        raise NoFilm(
            f"{path.name}: MP4 needs ffmpeg, which is not installed: pip install imageio-ffmpeg, or use .webp or .gif"
        )


def encoder() -> str | None:
    """Program that writes MP4: ffmpeg on the PATH, or that of imageio-ffmpeg; None without any."""
    if (program := shutil.which("ffmpeg")) is not None:
        return program
    if find_spec(_ENCODER) is None:
        return None
    try:
        return import_module(_ENCODER).get_ffmpeg_exe()
    except RuntimeError:  # a package without the program
        return None


_ENCODER = "imageio_ffmpeg"


class Camera:
    """Pictures of one run, all of the same part of the plane."""

    def __init__(self, shot: Shot, size: int):
        self.shot = shot
        self.scene, self.start = shot.data.scene, shot.data.start
        self.view = _view(self.scene, self.start, shot.frames, size)
        parts = self.scene.container.parts
        still = tuple(part for part in parts if not part.is_posed)
        container = self.scene.container.model_copy(update={"parts": still}) if len(still) < len(parts) else None
        self._still = (container or self.scene.container).section()
        walls = list(drawn_walls(self.scene, self.start.x))
        self._moving = [wall for wall in walls if wall.part is not None]
        self._turning = [wall for wall in walls if wall.spin and len(wall.mesh.outlines) > 1]
        self._clock = np.array([frame.time for frame in shot.frames])
        self._last: tuple[int, Image] | None = None

    def at(self, time: float) -> "Image":
        """Draw the bed in the last frame before a time [s]."""
        from PIL import Image

        k = max(0, int(np.searchsorted(self._clock, time * (1 + 1e-9), side="right")) - 1)
        if self._last is None or self._last[0] != k:
            self._last = k, Image.fromarray(self.pixels(self.shot.frames[k]))
        return self._last[1]

    def pixels(self, frame: Frame) -> np.ndarray:
        """RGB bytes of a frame, shape [height, width, 3], on the background of films."""
        pixels = self.rgba(frame)
        opacity = pixels[..., 3:].astype(np.float32) / 255
        return np.rint(pixels[..., :3] * opacity + np.array(BACKGROUND, np.float32) * (1 - opacity)).astype(np.uint8)

    def rgba(self, frame: Frame) -> np.ndarray:
        """RGBA bytes of a frame, shape [height, width, 4]."""
        return render(
            self.scene,
            self.start,
            packing_of(self.start, frame),
            view=self.view,
            colour=self.shot.colouring.of_frame(frame) / 255,
            walls=self._walls(frame.time),
            strokes=self._strokes(frame),
            finest=_FINE,
        )

    def _walls(self, time: float) -> list[Segment]:
        """Lines of the walls at a time [s]."""
        return [*self._still, *(line for wall in self._moving for mesh in wall.at([time]) for line in mesh.section())]

    def _strokes(self, frame: Frame) -> Strokes | None:
        """Contact forces, and marks by which a turning bottom is seen to turn."""
        marks = np.array([line for wall in self._turning for line in _marks(wall, frame.time)]).reshape(-1, 2, 2)
        strokes = [Strokes(marks, np.full(len(marks), _MARK), np.tile(_SPOKE, (len(marks), 1)))]
        if self.shot.forces is not None:
            strokes.insert(0, self._chains(self.shot.forces(frame)))
        ends, width, colour = (np.concatenate([getattr(one, name) for one in strokes]) for name in _STROKE_FIELDS)
        return Strokes(ends, width, colour) if len(ends) else None

    def _chains(self, forces: PairForces) -> Strokes:
        """Lines between the grains of the foremost layer that touch, wider and darker the larger the force."""
        grains = self.scene.grains
        deep = forces.ends[:, :, 1] - front(self.scene, self.start)
        fraction = np.minimum(forces.size / self.shot.colouring.top, 1.0)
        foremost = ((deep >= -grains.radius) & (deep <= grains.diameter * grains.aspect_ratio)).all(axis=1)
        rows = np.flatnonzero(foremost & (fraction > _FAINT))
        rows = rows[np.argsort(fraction[rows], kind="stable")]
        widest = _WIDEST * grains.diameter * self.view.scale
        width = np.maximum(_THINNEST, widest * fraction[rows])
        return Strokes(forces.ends[rows][:, :, [0, 2]], width, force_colours(fraction[rows]) / 255)


def _view(scene: Scene, start: Packing, frames: Sequence[Frame], size: int) -> Raster:
    """Part of the plane that holds the bed in all frames."""
    if scene.container.outlet_plane is not None:
        return Raster.of(scene, start, start, size)
    beds = [packing_of(start, frame) for frame in frames]
    x = np.concatenate([bed.x for bed in beds])
    q = np.concatenate([bed.q for bed in beds if bed.q is not None]) if beds[0].q is not None else None
    return Raster.of(scene, start, Packing(x=x, v=np.zeros_like(x), omega=np.zeros_like(x), q=q), size)


def _marks(wall: DrawnWall, time: float) -> Iterator[Segment]:
    """Lines (x, z) [m] of every second sector of the rim of a turning bottom, as seen from the front behind y = 0; of
    one that is not level its spokes there."""
    inner, outer = wall.mesh.outlines[0], wall.mesh.outlines[-1]
    (r, z0), (radius, z1) = ((float(np.hypot(*edge[0, :2])), float(edge[0, 2])) for edge in (inner, outer))
    first = wall.spin * time
    for k in range(_SECTORS):
        begin = (first + 2 * math.pi * k / _SECTORS) % (2 * math.pi)
        if abs(z1 - z0) > 1e-9:
            if math.sin(begin) >= 0:
                yield (r * math.cos(begin), z0), (radius * math.cos(begin), z1)
            continue
        for low, high in ((begin, begin + math.pi / _SECTORS), (begin - 2 * math.pi, begin - 15 * math.pi / _SECTORS)):
            low, high = max(low, 0.0), min(high, math.pi)
            if high > low:
                yield from _beside_hole(radius * math.cos(high), radius * math.cos(low), r, z1)


def _beside_hole(left: float, right: float, r: float, z: float) -> Iterator[Segment]:
    """Parts of a level line from `left` to `right` [m] that are not within r [m] of the axis."""
    for low, high in ((left, min(right, -r)), (max(left, r), right)):
        if high > low:
            yield (low, z), (high, z)


def _times(shots: Sequence[Shot], seconds: float) -> np.ndarray:
    """Times of the frames of a film [s], from the opening to the end of the longest run: at most so many as were
    recorded until then, and `_RATE` a second."""
    if not seconds > 0:
        raise NoFilm(f"a film cannot last {seconds:g} s; give a duration above 0")
    end = max(shot.end for shot in shots)
    recorded = max(sum(frame.time <= end for frame in shot.frames) for shot in shots)
    return np.linspace(0, end, max(1, min(recorded, round(_RATE * seconds))))


def _run_frames(camera: Camera, times: np.ndarray) -> Iterator["Image"]:
    """Frames of a film of one run: heading, bed, legend, and W(t) beside or below them."""
    bed, legend, chart = camera.at(0), _legend_of(camera), None
    upright = bed.height > bed.width
    if (curve := flow_curve(camera.shot.data)) is not None:
        size = _CHART if upright else (max(bed.width, _NARROWEST), _LOW)
        chart = FlowChart([FlowCurve(*curve, window=camera.shot.window)], float(times[-1]), *size)
    width = max(bed.width, _NARROWEST if chart is None else 0)
    beside = chart is not None and upright
    across = width + (_PAD + _CHART[0] if beside else 0)
    below = (_BAR if legend is not None else 0) + (_LOW if chart is not None and not upright else 0)
    top = _PAD + _LINE
    high = max(bed.height, _CHART[1] + _LINE if beside else 0) + below
    for time in times:
        canvas, write = _canvas(across + 2 * _PAD, top + high + _PAD)
        write(_PAD, _PAD - 2, _fitting(camera.shot.title, across - 90), _INK)
        write(across + _PAD, _PAD - 2, f"t = {time:.2f} s", QUIET, anchor="ra")
        picture = camera.at(time)
        canvas.paste(picture, (_PAD + (width - bed.width) // 2, top))
        if legend is not None:
            _draw_legend(canvas, legend, _PAD, top + bed.height + 4, width)
        if chart is not None:
            corner = (_PAD + width + _PAD, top + (high - below - _CHART[1]) // 2) if beside else (
                _PAD, top + high - _LOW)  # fmt: skip
            canvas.paste(chart.at(time), corner)
        yield canvas


def _sweep_frames(
    rows: Sequence[str], columns: Sequence[str], cameras: Mapping[tuple[int, int], Camera], times: np.ndarray
) -> Iterator["Image"]:
    """Frames of a film of several runs: headings of rows and columns, and the time."""
    endings = {cell: f"{c.shot.data.outcome} at {c.shot.stopped:.2f} s" for cell, c in cameras.items()}
    texts = [*(_extent(text)[0] for text in columns), *(_extent(text, _SMALL)[0] for text in endings.values())]
    wide = max(*(camera.view.across for camera in cameras.values()), *texts)
    tall = max(camera.view.down for camera in cameras.values())
    left = _PAD + (max((_extent(text)[0] for text in rows), default=0) + _PAD if any(rows) else 0)
    top, step_x, step_y = _PAD + 2 * _LINE, wide + _PAD, tall + _LINE
    legend = _legend_of(next(iter(cameras.values())))
    across, down = left + len(columns) * step_x, top + len(rows) * step_y + (_BAR if legend is not None else 0) + 4
    for time in times:
        canvas, write = _canvas(across, down)
        write(across - _PAD, _PAD - 2, f"t = {time:.2f} s", QUIET, anchor="ra")
        for k, text in enumerate(columns):
            write(left + k * step_x + wide // 2, _PAD + _LINE - 2, text, _INK, anchor="ma")
        for k, text in enumerate(rows):
            write(_PAD, top + k * step_y + tall // 2, text, _INK, anchor="lm")
        for (row, column), camera in cameras.items():
            x, y = left + column * step_x + (wide - camera.view.across) // 2, top + row * step_y
            canvas.paste(camera.at(time), (x, y + tall - camera.view.down))
            shot = camera.shot
            if time >= shot.stopped * (1 - 1e-9):
                write(left + column * step_x + wide // 2, y + tall, endings[row, column], QUIET, "ma", _SMALL)
        if legend is not None:
            _draw_legend(canvas, legend, left, down - _BAR, min(across - left - _PAD, 420))
        yield canvas


def _legend_of(camera: Camera) -> Legend | None:
    return camera.shot.colouring.legend()


def _draw_legend(canvas: "Image", legend: Legend, left: int, top: int, width: int) -> None:
    """Draw a bar of colours with its ticks and its title below."""
    from PIL import Image, ImageDraw

    bar = Image.fromarray(legend.colours[None].repeat(8, axis=0)).resize((width, 8), Image.Resampling.NEAREST)
    canvas.paste(bar, (left, top))
    write = ImageDraw.Draw(canvas)
    for x, label in _spaced_ticks(legend.ticks, width):
        anchor = "la" if x < 0.02 else "ra" if x > 0.98 else "ma"
        write.text((left + x * width, top + 10), label, QUIET, _font(10), anchor)
    write.text((left + width // 2, top + 22), legend.title, QUIET, _font(11), "ma")


def _spaced_ticks(ticks: Sequence[tuple[float, str]], width: int) -> Iterator[tuple[float, str]]:
    """The last tick, and from the first on those whose labels have room beside one another on a bar of a width in
    pixels."""

    def ends(tick: tuple[float, str]) -> tuple[float, float]:
        wide, x = _extent(tick[1], 10)[0], tick[0] * width
        left = x if tick[0] < 0.02 else x - wide if tick[0] > 0.98 else x - wide / 2
        return left, left + wide

    free, limit = -math.inf, ends(ticks[-1])[0] - _GAP
    for tick in ticks[:-1]:
        left, right = ends(tick)
        if left >= free and right <= limit:
            free = right + _GAP
            yield tick
    yield ticks[-1]


_GAP = 5  # pixels: least distance of two labels


def _canvas(width: int, height: int):
    """Page with even sides, as MP4 needs them, and a function that writes text on it."""
    from PIL import Image, ImageDraw

    canvas = Image.new("RGB", (width + width % 2, height + height % 2), BACKGROUND)
    draw = ImageDraw.Draw(canvas)

    def write(x: float, y: float, text: str, colour: tuple[int, int, int], anchor: str = "la", size: int = 13) -> None:
        draw.text((x, y), text, colour, _font(size), anchor)

    return canvas, write


@cache
def _font(size: int):
    from matplotlib import get_data_path
    from PIL import ImageFont

    return ImageFont.truetype(str(Path(get_data_path()) / "fonts/ttf/DejaVuSans.ttf"), size)


def _extent(text: str, size: int = 13) -> tuple[int, int]:
    """Width and height of a text in pixels."""
    left, top, right, bottom = _font(size).getbbox(text)
    return math.ceil(right - left), math.ceil(bottom - top)


def _fitting(text: str, width: float) -> str:
    """Shorten a text to a width in pixels."""
    if _extent(text)[0] <= width:
        return text
    while text and _extent(f"{text}…")[0] > width:
        text = text[:-1]
    return f"{text.rstrip(' ,')}…"


def _write(frames: Iterator["Image"], path: Path, seconds: float, source: str = "") -> FilmFile:
    images = list(frames)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() == ".mp4":
        _write_mp4(images, path, seconds)
    else:
        write_bytes(path, _encoded(images, path.suffix.lower(), seconds, source), durable=False)
    return FilmFile(path, len(images), images[0].size, seconds)


def _encoded(images: Sequence["Image"], form: str, seconds: float, source: str) -> bytes:
    """Film as WebP, with its source, or as GIF that repeats itself."""
    from PIL.Image import Dither

    stored = BytesIO()
    ends = [round(1000 * seconds * k / len(images)) for k in range(len(images) + 1)]
    durations = [end - begin for begin, end in pairwise(ends)]
    common = {"save_all": True, "duration": durations, "loop": 0}
    if form == ".webp":
        images[0].save(
            stored, "WEBP", append_images=images[1:], quality=_QUALITY, method=4, xmp=source.encode(), **common
        )
    else:
        palette = images[len(images) // 2].quantize(_PALETTE, dither=Dither.NONE)
        reduced = [image.quantize(palette=palette, dither=Dither.NONE) for image in images]
        reduced[0].save(stored, "GIF", append_images=reduced[1:], optimize=True, **common)
    return stored.getvalue()


def _write_mp4(images: Sequence["Image"], path: Path, seconds: float) -> None:
    """Write a film as MP4, in place by one rename; NoFilm if ffmpeg fails."""
    program = encoder()
    assert program is not None
    (width, height), unfinished = images[0].size, path.with_name(f".{path.name}.partial.mp4")
    command = [program, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
               "-r", f"{len(images) / seconds:.6g}", "-i", "-", "-pix_fmt", "yuv420p", "-crf", "20",
               "-movflags", "+faststart", str(unfinished)]  # fmt: skip
    try:
        done = subprocess.run(command, input=b"".join(image.tobytes() for image in images), capture_output=True)
        if done.returncode:
            raise NoFilm(f"ffmpeg could not write {path.name}: {done.stderr.decode(errors='replace').strip()[-300:]}")
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
