"""The key `include`: sections of a study from another file beside it, such as a material card."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from labbook.scene import attached
from labbook.scene.attached import AttachedError
from labbook.scene.scene import Scene
from labbook.study.problems import Problem, StudyError, instead, quote
from labbook.study.source import StudyText, parsed

SECTIONS = tuple(Scene.model_fields)
"""Sections that a file may have."""


def with_included(source: StudyText) -> StudyText:
    """Give a study the keys of the files that it includes; what it states itself goes before.

    Raises:
        StudyError: A file cannot be read, or has other keys.
    """
    if "include" not in source.data:
        return source
    names, data = source.data["include"], {key: value for key, value in source.data.items() if key != "include"}
    for name in [names] if isinstance(names, str) else names if isinstance(names, list) else [names]:
        data = _merged(_content(source, name), data)
    return replace(source, data=data)


def _content(source: StudyText, name: Any) -> dict[str, Any]:
    """Keys and values of a file."""
    line = source.line(("include",))
    if not isinstance(name, str):
        problem = f"{quote(name)} is no name of a file"
        raise StudyError(
            [Problem(source.path, line, "include", problem, "write the name of a file, glass.material.yaml")]
        )
    try:
        text = attached.content(source.beside.attach(name)).decode("utf-8-sig")
    except AttachedError as error:
        raise StudyError([Problem(source.path, line, "include", error.reason, error.remedy)]) from None
    except UnicodeDecodeError:
        problem = Problem(source.path, line, "include", f"{name} is not text in UTF-8", "save the file as UTF-8")
        raise StudyError([problem]) from None
    path = source.path.parent / name
    data, lines = parsed(path, text)
    foreign = [
        Problem(path, lines.get((key,), 0), quote(key), "a study does not include this key", instead(key, SECTIONS))
        for key in data
        if key not in SECTIONS
    ]
    if foreign:
        raise StudyError(foreign)
    return data


def _merged(included: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Both mappings, with what is `stated` where both have a value."""
    merged = dict(included)
    for key, value in own.items():
        inner = merged.get(key)
        both = isinstance(inner, Mapping) and isinstance(value, Mapping)
        merged[key] = _merged(inner, value) if both else value  # pyright: ignore[reportArgumentType]
    return merged
