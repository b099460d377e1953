"""Section of the page with the film of the sweep, or of a run, that the lab has."""

from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path

from labbook.export.film import is_film_of, source_of_film, source_of_sweep
from labbook.export.recording import path_of
from labbook.report.blocks import Folded, Picture, Prose, Section
from labbook.results.points import PointResult, RunResult
from labbook.results.study import StudyResults

_LARGEST = 6e6  # bytes: a page is one file
_WIDTH = "170mm"
SWEEP = "The first recorded run of every point, on one clock"


def film_sections(results: StudyResults, folder: Path) -> list[Section]:
    """The film of the whole sweep, or else of the first run with one; nothing where the lab has none. It plays when it
    is opened."""
    runs = [(result, run) for result in results.points for run in result.runs if run.recorded]
    path, caption = next(_films(results, runs), (None, ""))
    if path is None:
        return []
    if (size := path.stat().st_size) > _LARGEST:
        text = f"{caption}: {path.name} in the lab's films, {size / 1e6:.2g} MB, is too large for this page."
        return [Section("Film", (Prose(text),))]
    film = Picture(
        f"data:image/webp;base64,{b64encode(path.read_bytes()).decode('ascii')}",
        f"film: {caption}",
        f"{caption}: grains coloured by their height before the discharge.",
        _WIDTH,
    )
    return [Section("Film", (Folded(caption, (film,)),))]


def _films(results: StudyResults, runs: list[tuple[PointResult, RunResult]]) -> Iterator[tuple[Path, str]]:
    """Films of these runs that the lab has, with what each shows."""
    name = results.study.name
    films = runs[0][1].run.folder.parent.parent / "films" if runs else None
    if films is None or not (films / name).is_dir():
        return
    first = list({result.point.index: run.run.record for result, run in reversed(runs)}.values())[::-1]
    sweep = films / name / f"sweep-{first[0].backend}-layers.webp"
    if len(first) > 1 and is_film_of(sweep, source_of_sweep(first)):
        yield sweep, SWEEP
    for result, run in runs:
        path = path_of(films, run.run.record, name, result.point, "-layers.webp")
        if is_film_of(path, source_of_film(run.run.record)):
            yield path, ", ".join(filter(None, (result.label, run.repeat)))
