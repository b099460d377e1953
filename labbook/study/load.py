"""Reading a study file: everything that is wrong with it is found at once, before anything runs."""

from collections.abc import Iterator, Set
from itertools import islice
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from labbook.fit import COVERAGE, DEFINITIONS, FITS
from labbook.measure import FLOW_RATIO, MEASURES
from labbook.study.applicable import unfillable, unfittable, unmeasurable
from labbook.study.explain import complaints
from labbook.study.habits import habit
from labbook.study.keys import all_keys, nearest
from labbook.study.points import PointReader
from labbook.study.problems import MOST, Problem, StudyError, instead, meant, shown
from labbook.study.reference import ReferenceReader
from labbook.study.schema import SETTING_KEYS, TOP_KEYS, Settings
from labbook.study.source import Source, dotted, read
from labbook.study.study import Study
from labbook.study.sweep import MAX_POINTS, Sweep

MAX_RUNS = 200_000
"""Runs that a plan holds at once."""
_COMPARED = 200
"""Unknown keys that are compared with those that are known."""


def load(path: Path) -> Study:
    """The study in the file `path`. Raises StudyError with all problems that were found."""
    source = read(Path(path))
    problems = _unknown_keys(source)
    unknown = [key for key in source.data if key not in TOP_KEYS]
    misspelled = {meant(key, TOP_KEYS) for key in unknown[:_COMPARED]}
    settings = _settings(source, misspelled, problems)
    sweep = Sweep(source)
    reader = PointReader(source, sweep.wrong | misspelled)
    points = reader.read(sweep if sweep.size <= MAX_POINTS else islice(sweep, 1))
    reference = ReferenceReader(source, points, known_names, settings)
    published = reference.read()
    problems += [*sweep.problems, *reader.problems, *reference.problems]
    if settings is not None:
        problems += _unknown_names(source, settings)
        problems += _too_many_runs(source, settings, len(points))
        problems += unmeasurable(source, settings, points)
        problems += unfittable(source, settings, points)
        problems += unfillable(source, settings, points)
    if problems or settings is None:
        raise StudyError(problems)
    return Study(
        path=source.path,
        points=points,
        fill=points[0].fill,
        reference=published,
        numerics_stated=reader.numerics_stated,
        **{name: getattr(settings, name) for name in SETTING_KEYS},
    )


def known_names() -> set[str]:
    """Names of all measurements and laws, and of what reports make of them."""

    return {*MEASURES, *FITS, FLOW_RATIO}


def _unknown_keys(source: Source) -> list[Problem]:
    unknown = [key for key in source.data if key not in TOP_KEYS]
    # of thousands only the first are printed, and likenesses take time
    remedies = {key: _at_top(key, source.data) if n < MOST else "leave it out" for n, key in enumerate(unknown)}
    return [Problem(source.path, source.line((k,)), shown(k), "unknown key", remedies[k]) for k in unknown]


def _at_top(key: str, data: dict[str, Any]) -> str:
    """The remedy for an unknown key at the top of a study."""
    close = meant(key, TOP_KEYS)
    if close:
        return f"did you mean {close}?"
    contact = data.get("contact")
    foreign = habit(key, data[key], contact if isinstance(contact, dict) else {}, TOP_KEYS)
    if foreign is not None:
        return foreign.remedy
    return nearest(key) if any(known.name.rpartition(".")[2] == key for known in all_keys()) else instead(key, TOP_KEYS)


def _settings(source: Source, misspelled: Set[str | None], problems: list[Problem]) -> Settings | None:
    stated = {key: source.data[key] for key in SETTING_KEYS if key in source.data}
    try:
        return Settings.model_validate(stated, context={"units": "required"})
    except ValidationError as error:
        for found in complaints(error, stated):
            if dotted(found.location) not in misspelled:
                line, key = source.line(found.location), shown(dotted(found.location))
                problems.append(Problem(source.path, line, key, found.message, found.remedy))
        return None


def _too_many_runs(source: Source, settings: Settings, points: int) -> Iterator[Problem]:
    """More runs than a plan can hold."""
    runs = points * settings.replicates
    if runs > MAX_RUNS:
        message = f"{points} points of {settings.replicates} replicates are {runs} runs, more than {MAX_RUNS}"
        remedy = f"use at most {MAX_RUNS // points} replicates, or split the study"
        yield Problem(source.path, source.line(("replicates",)), "replicates", message, remedy)


def _unknown_names(source: Source, settings: Settings) -> Iterator[Problem]:
    """Measurements and fits that do not exist, and a fit of profiles that nothing measures."""

    for key, stated, known in (("measure", settings.measure, MEASURES), ("fit", settings.fit, FITS)):
        for index, name in enumerate(stated):
            if name not in known:
                line = source.line((key, index))
                what = "measurement" if key == "measure" else "law"
                message = f"no {what} is called {shown(name)}"
                yield Problem(source.path, line, key, message, instead(name, known))
    unmeasured = [name for name in settings.fit if name in DEFINITIONS and COVERAGE not in settings.measure]
    for name in unmeasured:
        line = source.line(("fit", settings.fit.index(name)))
        message = f"{name} cannot be fitted: profiles are not measured"
        yield Problem(source.path, line, "fit", message, f"add {COVERAGE} to measure")
