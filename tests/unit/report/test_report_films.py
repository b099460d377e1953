"""Reports hold the film of the sweep, or of a run, that the lab has."""

from base64 import b64decode
from types import SimpleNamespace
from typing import Any

import pytest
from PIL import Image

from labbook.export.film import source_of_film, source_of_sweep
from labbook.export.recording import path_of
from labbook.report import films
from labbook.report.blocks import Folded, Picture, Prose


def record(point: int, seed: int = 1) -> Any:
    coverage = SimpleNamespace(steps=100, frame_interval=0.01)
    return SimpleNamespace(
        run_key=f"{point}{seed}" * 8, coverage=coverage, point=point, seed=seed, discharge=1, backend="numba", study="s"
    )


def results(lab, points: int) -> Any:
    def result(point):
        run = SimpleNamespace(folder=lab / "runs" / str(point), record=record(point))
        shown = SimpleNamespace(recorded=True, run=run, repeat="seed 1")
        return SimpleNamespace(point=SimpleNamespace(index=point), label=f"D = {point} mm", runs=[shown])

    return SimpleNamespace(study=SimpleNamespace(name="s"), points=[result(point) for point in range(points)])


def made(path, source: str) -> bytes:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (8, 8)).save(path, "WEBP", xmp=source.encode())
    return path.read_bytes()


def test_the_film_of_the_sweep_comes_before_those_of_runs(tmp_path):
    folder, of_two = tmp_path / "films", results(tmp_path, 2)
    assert films.film_sections(of_two, tmp_path) == []
    made(path_of(folder, record(1), "s", None, "-layers.webp"), "of another run")
    assert films.film_sections(of_two, tmp_path) == []
    single = made(path_of(folder, record(1), "s", None, "-layers.webp"), source_of_film(record(1)))
    assert shown(films.film_sections(of_two, tmp_path)) == ("D = 1 mm, seed 1", single)
    sweep = made(folder / "s" / "sweep-numba-layers.webp", source_of_sweep([record(0), record(1)]))
    assert shown(films.film_sections(of_two, tmp_path)) == (
        "The first recorded run of every point, on one clock",
        sweep,
    )


def shown(sections) -> tuple[str, bytes]:
    """Caption and file of the film, which plays when it is opened."""
    ((section,),) = [sections]
    (folded,) = section.blocks
    assert isinstance(folded, Folded)
    (film,) = folded.blocks
    assert isinstance(film, Picture)
    return folded.title, b64decode(film.uri.removeprefix("data:image/webp;base64,"))


def test_a_film_that_is_too_large_is_named(tmp_path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(films, "_LARGEST", 10)
    made(path_of(tmp_path / "films", record(0), "s", None, "-layers.webp"), source_of_film(record(0)))
    ((section,),) = [films.film_sections(results(tmp_path, 1), tmp_path)]
    (text,) = section.blocks
    assert isinstance(text, Prose)
    assert "point-1-seed-1-numba-layers.webp" in text.text
