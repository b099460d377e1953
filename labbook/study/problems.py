"""Problems of a study file: messages with file, line, key and remedy."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

MAX_PRINTED = 20
"""Problems that are printed: many more are the same mistake again."""
_NUMBER = re.compile(r"\b[0-9a-f]{16,}\b|[0-9]+(\.[0-9]+)?(e[-+]?[0-9]+)?")
"""A key or a number within a message."""


@dataclass(frozen=True)
class Problem:
    """One thing wrong: where (line 1 is the first; 0: the file as a whole), under which key, what, and the remedy."""

    file: Path
    line: int
    key: str
    message: str
    remedy: str

    def __str__(self) -> str:
        location = f"{self.file}:{self.line}" if self.line else str(self.file)
        key = f"{self.key}: " if self.key else ""
        return f"{location}: {key}{self.message}\n    remedy: {self.remedy}"


class StudyError(Exception):
    """A study cannot be used; `problems` has everything that was found, in the order of the file."""

    def __init__(self, problems: Iterable[Problem]):
        self.problems = tuple(sorted(dict.fromkeys(problems), key=lambda problem: problem.line))
        lines = [str(problem) for problem in self.problems[:MAX_PRINTED]]
        if len(self.problems) > MAX_PRINTED:
            lines.append(f"and {len(self.problems) - MAX_PRINTED} more problems")
        super().__init__("\n".join(lines))


def instead(word: str, candidates: Iterable[str]) -> str:
    """The remedy for an unknown word: the known one that it resembles, else all that are known."""
    names = sorted(candidates)
    match = closest(word, names)
    if match:
        return f"did you mean {match}?"
    return f"known here: {', '.join(names)}" if names else "leave it out"


def closest(word: str, candidates: Iterable[str]) -> str | None:
    """The known word that `word` resembles, if there is one."""
    return next(iter(get_close_matches(word[:80], sorted(candidates), n=1, cutoff=0.7)), None)


def quote(value: object) -> str:
    """A value as it is quoted in a message: on one line and short."""
    text = value if isinstance(value, str) else repr(value)
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= 60 else text[:57] + "..."


def and_others(points: int) -> str:
    """ " and 3 other points", after the name of one; nothing for none."""
    return f" and {points} other point{'s' if points > 1 else ''}" if points > 0 else ""


def grouped(reasons: Sequence[str]) -> list[str]:
    """Reasons that differ in their numbers and keys only, as one line with a count: the first stands for all."""
    alike: dict[str, list[str]] = {}
    for reason in reasons:
        alike.setdefault(_NUMBER.sub("#", reason), []).append(reason)
    return [f"{one[0]} (and {len(one) - 1} more like it)" if len(one) > 1 else one[0] for one in alike.values()]
