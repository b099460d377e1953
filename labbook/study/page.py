"""The tables of docs/studies.md, written from the models: `python -m labbook.study.page docs/studies.md`.

What stands between `<!-- keys SECTION ... -->` and `<!-- end -->` is replaced; the rest of the page is written by hand.
"""

import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from labbook.study.keys import Key, all_keys, meaning
from labbook.study.schema import Fill

_MARKED = re.compile(r"(<!-- keys ([a-z_ ]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def with_tables(text: str) -> str:
    """`text` with the tables that it asks for."""
    return _MARKED.sub(lambda found: found[1] + "\n" + _table(found[2].split()) + "\n" + found[3], text)


def sections(text: str) -> list[str]:
    """The sections that `text` has tables of."""
    return [name for found in _MARKED.finditer(text) for name in found[2].split()]


def _table(names: list[str]) -> str:
    keys = _merged([key for key in documented_keys() if key.name.partition(".")[0] in names])
    rows = ["| key | value | default | meaning |", "|---|---|---|---|"]
    return "\n".join(rows + [_row(key) for key in keys]) + "\n"


AGAIN = {"fill.contact.": "contact"}
"""Sections within sections that have all keys of another one."""


def documented_keys() -> Iterator[Key]:
    """All keys; of a section that has the keys of another one only its name."""
    listed = set[str]()
    for key in all_keys():
        inner = next((one for one in AGAIN if key.name.startswith(one)), None)
        if inner is None:
            yield key
        elif inner not in listed:
            listed.add(inner)
            name = inner.removesuffix(".")
            yield Key(name, f"as `{AGAIN[inner]}`", default="none", meaning=meaning(Fill, name.partition(".")[2]))


def _merged(keys: Sequence[Key]) -> list[Key]:
    """The keys, those that several choices have in common as one: `law: hertz-printed, hertz-lammps`."""
    groups: dict[Key, list[str]] = {}
    for key in keys:
        groups.setdefault(replace(key, of=""), []).append(key.of)
    return [replace(key, of=_joined(of)) for key, of in groups.items()]


def _joined(of: Sequence[str]) -> str:
    what = of[0].partition(": ")[0]
    return ", ".join([of[0], *(text.removeprefix(f"{what}: ") for text in of[1:])])


def _row(key: Key) -> str:
    default = "required" if key.default is None else f"`{key.default}`" if key.default != "none" else "none"
    of = f" ({key.of})" if key.of else ""
    return f"| `{key.name}`{of} | {_value(key)} | {default} | {key.meaning.replace('|', '/')} |"


def _value(key: Key) -> str:
    if key.choices:
        return ", ".join(f"`{choice}`" for choice in key.choices)
    words = {"quantity": f"quantity [{key.unit}]" if key.unit else "number", "integer": "whole number"}
    kind = words.get(key.type, f"{key.type} [{key.unit}]" if key.unit else key.type)
    return f"{kind} {key.limits}".strip()


if __name__ == "__main__":
    page = Path(sys.argv[1])
    page.write_text(with_tables(page.read_text(encoding="utf-8")), encoding="utf-8")
