"""Count names and docstrings that are hard to read, room by room; neither count may grow, nor pass a ceiling.

    python tests/language.py            compare with language.json; `make lint` runs this
    python tests/language.py --list     print each place (further arguments: rooms, such as labbook/run)
    python tests/language.py --write    write the counts of today into language.json

names      Pronouns, and participles used as nouns (`WORDS`): functions, classes, variables, attributes and arguments in
           scopes of more than three lines. Underscores around a name, and capitals, do not count.
docstrings Those whose first word is relative (`OPENINGS`), of modules, classes, functions and variables (a string in
           the line below).

The ceilings (`CEILINGS`) are shares of the whole tree, with names of scopes of any length: they hold even if somebody
writes higher counts into the file.
"""

import ast
import json
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
COUNTS = Path(__file__).with_suffix(".json")
SHORT = 3
"""Lines of a scope in which any name is read at a glance."""
WORDS = frozenset(
    """
    it its this that these those one ones other others each many most more much such same what which who whose whom
    thing things
    asked chosen drawn foreseen found given gone heard held kept known looked made meant named picked said seen shown
    stated taken told unknown unstated wanted written
    """.split()  # noqa: SIM905
)
OPENINGS = frozenset(
    """
    what whatever whether how where wherever which whichever who whose whom when whenever why that those these this it
    its they as if so
    """.split()  # noqa: SIM905
)
CEILINGS = {"names": 1.5, "docstrings": 3.0}
"""Largest shares [%] of all names, in scopes of any length, and of all docstrings."""
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
SCOPES = (ast.ClassDef, *FUNCTIONS, ast.Lambda, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


@dataclass(frozen=True)
class Place:
    """A name or a docstring that counts.

    Args:
        kind: `names` or `docstrings`.
        line: its line, from 1.
        text: the name, or the first line of the docstring.
    """

    kind: str
    line: int
    text: str


def places(source: str) -> list[Place]:
    """Everything in a module that counts, in the order of lines."""
    tree, length = ast.parse(source), len(source.splitlines())
    names = (Place("names", line, name) for line, name in _names(tree, length) if _unclear(name))
    texts = (
        Place("docstrings", line, text.strip().split("\n")[0]) for line, text in _docstrings(tree) if _relative(text)
    )
    return sorted([*names, *texts], key=lambda place: place.line)


def _names(node: ast.AST, lines: int) -> Iterator[tuple[int, str]]:
    """Line and name of everything that is named below a node, in scopes of more than `SHORT` lines.

    Args:
        node: where to look.
        lines: length of the scope that `node` stands in.
    """
    for child in ast.iter_child_nodes(node):
        if lines > SHORT:
            yield from _bound(child)
        yield from _names(child, _length(child) if isinstance(child, SCOPES) else lines)


def _length(node: ast.stmt | ast.expr) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def _bound(node: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and name, if a node names something."""
    match node:
        case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
            yield node.lineno, node.name
        case ast.Name(ctx=ast.Store()):
            yield node.lineno, node.id
        case ast.Attribute(ctx=ast.Store()):
            yield node.lineno, node.attr
        case ast.arg():
            yield node.lineno, node.arg
        case ast.alias(asname=str() as name) | ast.ExceptHandler(name=str() as name) | ast.MatchAs(name=str() as name):
            yield node.lineno, name


def _docstrings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of every docstring: the first statement of a body, or the one below an assignment."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if not isinstance(body, list):
            continue
        holds = isinstance(node, (ast.Module, ast.ClassDef, *FUNCTIONS))
        for before, statement in zip([None, *body], body, strict=False):
            if not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)):
                continue
            text = statement.value.value
            documents = holds if before is None else isinstance(before, (ast.Assign, ast.AnnAssign))
            if isinstance(text, str) and documents:
                yield statement.lineno, text


def _unclear(name: str) -> bool:
    return name.strip("_").lower() in WORDS


def _relative(text: str) -> bool:
    word = re.match(r"\W*([A-Za-z]+)", text)
    return word is not None and word[1].lower() in OPENINGS


def rooms() -> dict[str, list[Path]]:
    """Modules of each room: a package or module of labbook, a package of `backends` or `web`."""
    modules: dict[str, list[Path]] = {}
    for folder in ("labbook", "backends", "web"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            modules.setdefault("/".join(parts[:2]), []).append(path)
    return modules


def counts() -> dict[str, dict[str, int]]:
    """Number of names and of docstrings that count, by room."""
    totals = {}
    for room, modules in rooms().items():
        kinds = [place.kind for path in modules for place in places(path.read_text(encoding="utf-8"))]
        totals[room] = {kind: kinds.count(kind) for kind in ("names", "docstrings")}
    return totals


def shares(sources: Iterable[str]) -> dict[str, float]:
    """Share [%] of all names, in scopes of any length, and of all docstrings that are hard to read."""
    names: list[bool] = []
    docstrings: list[bool] = []
    for source in sources:
        tree = ast.parse(source)
        names += [_unclear(name) for node in ast.walk(tree) for _, name in _bound(node)]
        docstrings += [_relative(text) for _, text in _docstrings(tree)]
    return {
        kind: 100 * sum(unclear) / max(1, len(unclear))
        for kind, unclear in (("names", names), ("docstrings", docstrings))
    }


def compare(now: dict[str, dict[str, int]], allowed: dict[str, dict[str, int]]) -> tuple[list[str], list[str]]:
    """Sentences about counts that grew, and about counts that fell. A room that is not listed may have none."""
    grown, fallen = [], []
    for room in sorted({*now, *allowed}):
        for kind in ("names", "docstrings"):
            was, count = (table.get(room, {}).get(kind, 0) for table in (allowed, now))
            if count > was:
                grown.append(f"{room}: {count} {kind}, {was} allowed; python tests/language.py --list {room}")
            elif count < was:
                fallen.append(f"{room}: {count} {kind} instead of {was}")
    return grown, fallen


def write(totals: dict[str, dict[str, int]]) -> None:
    """Write the counts as JSON, a line for each room that has any: branches that change different rooms merge."""
    listed = {room: numbers for room, numbers in sorted(totals.items()) if any(numbers.values())}
    lines = ",\n".join(f"  {json.dumps(room)}: {json.dumps(numbers)}" for room, numbers in listed.items())
    COUNTS.write_text("{\n" + lines + "\n}\n", encoding="utf-8")


def main(arguments: list[str]) -> int:
    """Carry out the command line; the exit status is 1 if a count grew or a share passes its ceiling."""
    if arguments[:1] == ["--list"]:
        for path in (
            path for room, modules in rooms().items() if room in (arguments[1:] or [room]) for path in modules
        ):
            for place in places(path.read_text(encoding="utf-8")):
                print(f"{path.relative_to(ROOT)}:{place.line}: {place.kind[:-1]}: {place.text}")
        return 0
    now = counts()
    total = "{} names, {} docstrings".format(
        *(sum(room[kind] for room in now.values()) for kind in ("names", "docstrings"))
    )
    if arguments == ["--write"]:
        write(now)
        print(f"{COUNTS.name}: {total}")
        return 0
    grown, fallen = compare(now, json.loads(COUNTS.read_text(encoding="utf-8")))
    parts = shares(path.read_text(encoding="utf-8") for modules in rooms().values() for path in modules)
    grown += [
        f"{share:.2f} % of all {kind}, {CEILINGS[kind]} % allowed"
        for kind, share in parts.items()
        if share > CEILINGS[kind]
    ]
    for line in grown:
        print(f"language: {line}")
    if grown:
        print("language: use a noun of the field for a name; open a docstring with a verb or a noun (CONTRIBUTING.md)")
    elif fallen:
        print("language: fewer than before, keep it so: python tests/language.py --write")
        print("\n".join(f"  {line}" for line in fallen))
    else:
        print(
            f"language: {total}, as before; with short scopes "
            + ", ".join(f"{share:.1f} % of {kind}" for kind, share in parts.items())
        )
    return bool(grown)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
