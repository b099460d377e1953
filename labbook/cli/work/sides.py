"""The options of `labbook compare` that name two of a kind: `--backends numba,warp`, `--devices cpu,cuda:0`."""

from typing import get_args

from labbook.backend.numerics import Precision
from labbook.checks.compare.sides import CannotCompare, Pair, Precisions, pair_of, refuse_same
from labbook.checks.compare.verdict import called


def parse(backends: str, devices: str, precisions: str | None = None) -> Pair:
    """Read both sides from `numba,warp`, `cpu,cuda:0` and `double,mixed`. Raises CannotCompare or BackendMissing."""
    names, both = _two(backends, "--backends", "numba,warp"), _two(devices, "--devices", "cpu,cuda:0")
    of = _precisions(precisions)
    _differ(names, of)
    return pair_of(names, both, of)


def names_of(backends: str, precisions: str | None = None) -> tuple[str, str]:
    """Name both sides as verdicts do, without loading a backend. Raises CannotCompare."""
    names, of = _two(backends, "--backends", "numba,warp"), _precisions(precisions)
    _differ(names, of)
    return called(names[0], of[0]), called(names[1], of[1])


def _differ(names: tuple[str, str], precisions: Precisions) -> None:
    try:
        refuse_same(names, precisions)
    except CannotCompare:
        remedy = "name two backends, such as numba,warp, or --precisions double,mixed"
        raise CannotCompare(f"--backends: {names[0]} is compared with itself; {remedy}") from None


def _precisions(text: str | None) -> Precisions:
    if text is None:
        return None, None
    by_word: dict[str, Precision] = {word: word for word in get_args(Precision)}
    words = _two(text, "--precisions", "double,mixed")
    if absent := [word for word in words if word not in by_word]:
        raise CannotCompare(f"--precisions: no precision is called {absent[0]}; use two of {', '.join(by_word)}")
    return by_word[words[0]], by_word[words[1]]


def _two(text: str, option: str, example: str) -> tuple[str, str]:
    words = [word.strip() for word in text.split(",")]
    if len(words) != 2 or not all(words):
        need = f"two names separated by a comma are needed, such as {example}"
        raise CannotCompare(f"{option}: {need}, not {text!r}")
    return words[0], words[1]
