"""The keys of a study as types, written from the models: `python -m labbook.study.static labbook/study/stated.py`.

Editors and type checkers read them: they complete keys and choices of `define` and `change`, and show what keys mean.
"""

import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import fill

from labbook.fit import LAWS
from labbook.measure import MEASURES
from labbook.study.keys import Key, all_keys
from labbook.study.page import AGAIN, documented_keys
from labbook.study.schema import TOP_KEYS

_HEAD = '''"""The keys of a study as types. Generated from the models by `labbook.study.static`; do not edit.

All values may be of any type: they are checked when the study is made. Types only list the known keys and choices.
"""
# fmt: off
# ruff: noqa: E501

from collections.abc import Mapping, Sequence
from typing import Literal, TypeAlias, TypedDict

'''
_TYPES = {
    "sweep": "Swept | object",
    "points": "Sequence[Swept | object] | object",
    "reference": "Mapping[str, object] | object",
    "adapt": "Mapping[str, object] | object",
    "calibrate": "Mapping[str, object] | object",
    "include": "str | Sequence[str] | object",
}
"""Keys of a study that no model has."""
_NAMES = {"measure": MEASURES, "fit": LAWS}


@dataclass
class _Section:
    """A section of a study: its keys, by their last part, and the sections within it."""

    name: str
    keys: dict[str, list[Key]] = field(default_factory=dict)
    inner: dict[str, "_Section"] = field(default_factory=dict)

    @property
    def type(self) -> str:
        """Name of its type: `GrainsKindsKeys` for `grains.kinds[]`."""
        return f"{''.join(word.capitalize() for word in re.findall('[a-z]+', self.name)) or 'Study'}Keys"

    def add(self, key: Key) -> None:
        """Put a key in its place."""
        section, *parts = self, *key.name.split(".")
        for part in parts[:-1]:
            inner = f"{section.name}.{part}".removeprefix(".")
            section = section.inner.setdefault(part, _Section(inner))
        section.keys.setdefault(parts[-1], []).append(key)


def module_text() -> str:
    """The module `labbook.study.stated`."""
    root = _Section("")
    for key in documented_keys():
        root.add(key)
    swept = [key.name.replace("*", "all") for key in all_keys() if key.sweepable]
    changed = [key.name.replace("*", "all") for key in all_keys() if "[]" not in key.name]
    parts = [
        _HEAD + _flat("Swept", "Dotted keys that a sweep may vary.", swept),
        _flat("Changed", "Dotted keys that `Study.change` takes.", [*changed, *(f"sweep.{key}" for key in swept)]),
        *_classes(root),
        f"LawName: TypeAlias = {_choice(LAWS)}\n" + '"""Names of the laws of flow."""\n',
        f'KEYS = """\\\n{_summary(root)}"""\n"""The keys of a study by sections, with SI units."""\n',
    ]
    return "\n\n".join(parts)


def _flat(name: str, meaning: str, keys: Iterable[str]) -> str:
    fields = _wrapped(", ".join(f'"{key}":~object' for key in dict.fromkeys(keys)), "    ").replace("~", " ")
    return f'{name} = TypedDict("{name}", {{\n{fields},\n}}, total=False)\n"""{meaning}"""\n'


def _classes(section: _Section) -> Iterator[str]:
    """The type of a section, after those of the sections within it."""
    for inner in section.inner.values():
        yield from _classes(inner)
    if section.inner.keys() == {"*"}:  # by names of walls
        return
    title = f"Section `{section.name}`" if section.name else "All keys of a study"
    body = [f'class {section.type}(TypedDict, total=False):\n    """{title}."""\n']
    names = [*section.keys, *section.inner] if section.name else [*dict.fromkeys(TOP_KEYS)]
    for name in names:
        bare = name.removesuffix("[]")
        if name in section.inner:
            body.append(f"    {bare}: {_section_type(name, section.inner[name])}")
        elif name in section.keys:
            body.append(f"    {bare}: {_value_type(section.keys[name])}\n{_meaning(section.keys[name])}")
        else:
            body.append(f"    {name}: {_TYPES[name] if name in _TYPES else _listed(section, name)}")
    yield "\n".join(body) + "\n"


def _listed(root: _Section, name: str) -> str:
    return _section_type(f"{name}[]", root.inner[f"{name}[]"])


def _section_type(name: str, section: _Section) -> str:
    if section.inner.keys() == {"*"}:
        return f"Mapping[str, {section.inner['*'].type} | object] | object"
    return f"Sequence[{section.type} | object] | object" if name.endswith("[]") else f"{section.type} | object"


def _value_type(keys: list[Key]) -> str:
    name = keys[0].name
    if name in _NAMES:
        return f"Sequence[{_choice(_NAMES[name])} | object] | object"
    if f"{name}." in AGAIN:
        return f"{AGAIN[f'{name}.'].capitalize()}Keys | object"
    choices = dict.fromkeys(choice for key in keys for choice in key.choices)
    return f"{_choice(choices)} | object" if choices else "object"


def _choice(words: Iterable[str]) -> str:
    return "Literal[" + ", ".join(f'"{word}"' for word in words) + "]"


def _meaning(keys: list[Key]) -> str:
    """The docstring of a key: its meaning, unit and range for each choice that has one of its own."""
    texts = dict[str, list[str]]()
    for key in keys:
        unit = f" [{key.unit}]" if key.unit else ""
        limits = f" Range: {key.limits}." if key.limits else ""
        texts.setdefault(f"{key.meaning.removesuffix('.')}{unit}.{limits}", []).append(key.of)
    lines = [text if len(texts) == 1 else f"{' or '.join(of)}: {text}" for text, of in texts.items()]
    return "\n\n".join(_wrapped(line, "    ") for line in [f'"""{lines[0]}', *lines[1:]]) + '"""'


def _summary(section: _Section) -> str:
    """The keys with their SI units, a section a paragraph."""
    words = []
    for name, keys in section.keys.items():
        unit = next((key.unit for key in keys if key.unit), "")
        words.append(f"{name} [{unit}]" if unit else name)
    text = f"{section.name}: " if section.name else ""
    lines = [_wrapped(f"{text}{', '.join(words)}", "    ", "        ") + "\n"] if words else []
    return "".join([*lines, *(_summary(inner) for inner in section.inner.values())])


def _wrapped(text: str, indent: str, further: str | None = None) -> str:
    further = indent if further is None else further
    return fill(text, 116, initial_indent=indent, subsequent_indent=further, break_on_hyphens=False)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(module_text(), encoding="utf-8")
