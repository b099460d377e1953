"""Reading YAML into plain values, with the line of every key; what cannot be read is a StudyError."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from labbook.study.problems import Problem, StudyError, shown

MAX_BYTES = 2_000_000
MAX_NODES = 100_000
MAX_DEPTH = 30

_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")

Location = tuple[str | int, ...]
"""Keys and list indices from the top of the file to a value."""

_TAG = "tag:yaml.org,2002:"


@dataclass
class Source:
    """A study file as plain dicts, lists and scalars, and the line on which each of its keys and items stands."""

    path: Path
    data: dict[str, Any]
    lines: dict[Location, int] = field(default_factory=dict)

    def line(self, location: Location) -> int:
        """Line of the key at `location`, or of what encloses it; 0 when nothing does."""
        while location and location not in self.lines:
            location = location[:-1]
        return self.lines.get(location, 0)


def dotted(location: Location) -> str:
    """`container.parts[0].name` for ("container", "parts", 0, "name")."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return text.removeprefix(".")


def read(path: Path) -> Source:
    """Read a study file. Raises StudyError if it cannot be read, is not YAML, or repeats keys."""
    text = _text(path)
    root = _compose(path, text)
    walker = _Walker(path)
    data = walker.plain(root, (), ())
    if walker.problems:
        raise StudyError(walker.problems)
    if not isinstance(data, dict):
        problem = Problem(path, 1, "", "a study is a mapping of keys", "begin with a line such as `name: my-study`")
        raise StudyError([problem])
    return Source(path, data, walker.lines)


def _text(path: Path) -> str:
    try:
        with open(path, "rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not a usable file name"
        remedy = "give the path of a study file; `labbook new NAME` writes one"
        raise StudyError([Problem(path, 0, "", f"cannot be read: {reason}", remedy)]) from None
    if len(raw) > MAX_BYTES:
        remedy = "write long lists as sweeps, or split the study"
        raise StudyError([Problem(path, 0, "", f"larger than {MAX_BYTES // 1_000_000} MB", remedy)])
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise StudyError([Problem(path, line, "", "not text in UTF-8", "save the file as UTF-8")]) from None


class _TooMany(Exception):
    def __init__(self, line: int):
        super().__init__(line)
        self.line = line


def _compose(path: Path, text: str):
    """The tree of YAML nodes, or None for an empty file."""
    from ruamel.yaml import YAML
    from ruamel.yaml.composer import Composer
    from ruamel.yaml.error import MarkedYAMLError

    class Counting(Composer):
        """Stops at MAX_NODES: a larger file would be read for minutes."""

        nodes = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            self.nodes += 1
            if self.nodes > MAX_NODES:
                raise _TooMany(self.loader.parser.peek_event().start_mark.line + 1)
            return super().compose_node(parent, index)

    reader = YAML(typ="safe", pure=True)
    reader.Composer = Counting
    try:
        root = reader.compose(text)
    except _TooMany as many:
        message = f"more than {MAX_NODES} values"
        raise StudyError(
            [Problem(path, many.line, "", message, "write long lists as sweeps, or split the study")]
        ) from None
    except RecursionError:
        raise StudyError([Problem(path, _deep(text), "", "nested too deeply", "a study needs few levels")]) from None
    except Exception as error:  # a parser on arbitrary text: whatever stops it, the text is not YAML
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        line = mark.line + 1 if mark is not None else text.count("\n", 0, getattr(error, "position", 0)) + 1
        reason = error.problem if isinstance(error, MarkedYAMLError) and error.problem else "unreadable"
        message = f"not valid YAML: {shown(' '.join(str(reason).split()))}"
        raise StudyError([Problem(path, line, "", message, _yaml_remedy(text, line))]) from None
    if root is None:
        raise StudyError([Problem(path, 1, "", "the file is empty", "`labbook new NAME` writes a study to begin with")])
    return root


def _deep(text: str) -> int:
    """The line on which brackets first stand deeper than a study nests; 1 if it is not brackets that do."""
    depth = 0
    for number, line in enumerate(text.splitlines(), start=1):
        for character in line:
            depth += (character in "[{") - (character in "]}")
            if depth > MAX_DEPTH:
                return number
    return 1


def _yaml_remedy(text: str, line: int) -> str:
    if (strange := _CONTROL.search(text)) is not None:
        place = text.count("\n", 0, strange.start()) + 1
        return f"remove the character {ord(strange[0]):#04x} on line {place}: no text has it"
    lines = text.splitlines()
    near = lines[max(line - 2, 0) : line]
    if any("\t" in candidate for candidate in near):
        return "indent with blanks, not with tabs"
    if any("]" in candidate and candidate.rsplit("]", 1)[1].strip(" ,}") for candidate in near):
        return 'put a list that is followed by its unit in quotes: "[15, 30] deg"'
    return "check the indentation, quotes, brackets and colons on this line and the one before"


class _Walker:
    """Turns nodes into plain values; notes lines, repeated keys and what a study cannot hold."""

    def __init__(self, path: Path):
        from ruamel.yaml import YAML

        self.path = path
        self._constructor = YAML(typ="safe", pure=True).constructor
        self.lines: dict[Location, int] = {}
        self.problems: list[Problem] = []
        self._nodes = 0

    def plain(self, node: Any, location: Location, above: tuple[int, ...]) -> Any:
        from ruamel.yaml.nodes import MappingNode, SequenceNode

        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise StudyError(
                [self._problem(node, location, "too many values", "write long lists as sweeps; use fewer aliases")]
            )
        if id(node) in above or len(above) > MAX_DEPTH:
            self.problems.append(
                self._problem(node, location, "nested too deeply, or in itself", "write it out without aliases")
            )
            return None
        above = (*above, id(node))
        if isinstance(node, MappingNode):
            return self._mapping(node, location, above)
        if isinstance(node, SequenceNode):
            for index, item in enumerate(node.value):
                self.lines[*location, index] = item.start_mark.line + 1
            return [self.plain(item, (*location, index), above) for index, item in enumerate(node.value)]
        return self._scalar(node, location)

    def _mapping(self, node: Any, location: Location, above: tuple[int, ...]) -> dict[str, Any]:
        from ruamel.yaml.nodes import ScalarNode

        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, ScalarNode):
                self.problems.append(
                    self._problem(key_node, location, "a key is a word, not a list or a mapping", "write `key: value`")
                )
                continue
            key = key_node.value
            here = (*location, key)
            if key in result:
                message = f"stated twice, first on line {self.lines[here]}"
                self.problems.append(self._problem(key_node, here, message, "keep one of the two"))
                continue
            self.lines[here] = key_node.start_mark.line + 1
            result[key] = self.plain(value_node, here, above)
        return result

    def _scalar(self, node: Any, location: Location) -> Any:
        tag, text = str(node.tag), node.value
        kind = tag.removeprefix(_TAG)
        if kind in ("str", "timestamp"):
            return text
        if kind == "null":
            return None
        if kind not in ("bool", "int", "float") or not tag.startswith(_TAG):
            self.problems.append(self._problem(node, location, f"the tag {shown(tag)} is unknown", "leave the tag out"))
            return None
        try:
            return getattr(self._constructor, f"construct_yaml_{kind}")(node)
        except (ValueError, KeyError, IndexError, OverflowError):
            return text

    def _problem(self, node: Any, location: Location, message: str, remedy: str) -> Problem:
        return Problem(self.path, node.start_mark.line + 1, shown(dotted(location)), message, remedy)
