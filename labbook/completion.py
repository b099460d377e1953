"""Completion within quotes in notebooks and IPython: keys and choices of a study, names of laws and figures.

`%load_ext labbook` turns it on. Names come from the objects at hand: figures of these results, laws that are installed.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from labbook.fit import LAWS
from labbook.measure import MEASURES
from labbook.study.keys import all_keys, find, siblings

_OPEN, _CLOSE = "([{", ")]}"
_NAMES = {"measure": MEASURES, "fit": LAWS}


@dataclass
class _Bracket:
    """An open bracket: the function before it (of a call), its key (of a dict or list), and the key at the cursor."""

    kind: str
    name: str
    key: str = ""


def offered(text: str, namespace: Mapping[str, Any]) -> tuple[str, list[str]]:
    """The unfinished word at the end of `text`, which is in quotes, and the words that may stand there.

    namespace: objects by name. Outside of `define`, `change`, `plot`, `fit` and the argument `at` nothing is offered.
    """
    brackets, word = _read(text)
    calls = [at for at, bracket in enumerate(brackets) if bracket.kind == "("]
    if word is None or not calls:
        return "", []
    call, inside = brackets[calls[-1]], brackets[calls[-1] + 1 :]
    owner, _, function = call.name.rpartition(".")
    words: Iterable[str] = ()
    if function in ("define", "change"):
        words = _of_study(call, inside, dotted=function == "change")
    elif inside and call.key == "at":
        words = _swept()
    elif function == "plot" and not inside:
        words = getattr(namespace.get(owner), "figures", tuple)()
    elif function == "fit" and not inside:
        words = LAWS
    return word, sorted({name for name in words if name.startswith(word)})


def _of_study(call: _Bracket, inside: list[_Bracket], dotted: bool) -> Iterable[str]:
    """Words at the cursor within `define(` or `change(`: keys of a section, or the choices of a key."""
    last = inside[-1] if inside else call
    brackets = [bracket for bracket in inside if bracket.name]
    path = [part.name if part is last or part.kind == "{" else f"{part.name}[]" for part in brackets]
    if path and path[0] in ("sweep", "points[]"):
        return _swept() if last.kind == "{" and not last.key else ()
    key = ".".join([*path, last.key] if last.key else path)
    if last.kind == "{" and not last.key:
        if path or not dotted:
            return siblings(f"{key}.x" if path else "x")
        return [known.name for known in all_keys() if "[]" not in known.name] + [f"sweep.{name}" for name in _swept()]
    return _NAMES.get(key) or [choice for known in find(key) for choice in known.choices]


def _swept() -> list[str]:
    return [key.name for key in all_keys() if key.sweepable]


def _read(text: str) -> tuple[list[_Bracket], str | None]:
    """The brackets that are open at the end of `text`, and the unfinished text in quotes; None outside of quotes."""
    brackets, last, column = list[_Bracket](), "", 0
    while column < len(text):
        letter = text[column]
        if letter in "\"'":
            end = text.find(letter, column + 1)
            if end < 0:
                return brackets, text[column + 1 :]
            last, column = text[column + 1 : end], end
        elif letter in _OPEN:
            before = re.search(r"([\w.]+)\s*$", text[:column])
            name = (before[1] if before else "") if letter == "(" else brackets[-1].key if brackets else ""
            brackets.append(_Bracket(letter, name))
        elif letter in _CLOSE and brackets:
            brackets.pop()
        elif letter == ":" and brackets:
            brackets[-1].key = last
        elif letter == "=" and brackets:
            before = re.search(r"(\w+)\s*$", text[:column])
            brackets[-1].key = before[1] if before else ""
        elif letter == "," and brackets:
            brackets[-1].key = ""
        column += 1
    return brackets, None


def install(shell: Any) -> None:
    """Add the completion to a shell of IPython."""
    from IPython.core.completer import SimpleCompletion, context_matcher  # pyright: ignore[reportMissingImports]

    @context_matcher()
    def labbook_words(context: Any) -> dict[str, Any]:
        lines = context.full_text.split("\n")[: context.cursor_line]
        word, words = offered("\n".join([*lines, context.text_until_cursor]), shell.user_ns)
        completions = [SimpleCompletion(text=name, type="text") for name in words]
        return {"completions": completions, "matched_fragment": word, "suppress": bool(completions)}

    shell.Completer.custom_matchers.append(labbook_words)
