"""Text of a study as plain values: read from YAML, with the line of every key, or given in Python. Reading raises
StudyError."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import Any

from labbook.scene.attached import StudyFolder
from labbook.study.problems import Problem, StudyError, quote

MAX_BYTES = 2_000_000
MAX_NODES = 100_000
MAX_DEPTH = 30

_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")

Location = tuple[str | int, ...]
"""Keys and list indices from the top of the file to a value."""

_TAG = "tag:yaml.org,2002:"


@dataclass
class StudyText:
    """A study file as plain dicts, lists and scalars, and the line on which each of its keys and items stands."""

    path: Path
    data: dict[str, Any]
    lines: dict[Location, int] = field(default_factory=dict)
    text: str = ""
    """The file as it was read; empty for a study given in Python."""
    beside: StudyFolder = field(default_factory=StudyFolder)
    """Folder of the files that it names."""

    def line(self, location: Location) -> int:
        """Line of the key at `location`, or of what encloses it; 0 when nothing does."""
        while location and location not in self.lines:
            location = location[:-1]
        return self.lines.get(location, 0)


def dotted(location: Location) -> str:
    """`container.parts[0].name` for ("container", "parts", 0, "name")."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return text.removeprefix(".")


def given_path(path: Path | str, name: str) -> Path:
    """A path that was given in Python, with the home folder in place of `~`. what: what it is of, for the error.

    Raises TypeError for what is no path, ValueError for an empty text or the home folder of an unknown user.
    """
    if not isinstance(path, str | PathLike):
        raise TypeError(f"{name}: a path is needed, as text or a pathlib.Path, and not {path!r}")
    if not os.fspath(path):
        raise ValueError(f"{name}: the path is empty (the current folder is '.')")
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise ValueError(f"{name}: {os.fspath(path)}: {error}; give the path from the root folder") from None


def read(path: Path) -> StudyText:
    """Read a study file. Raises StudyError if it cannot be read, is not YAML, or repeats keys."""
    text = _text(path)
    data, lines = parsed(path, text)
    return StudyText(path, data, lines, text, StudyFolder.of(path))


def parsed(path: Path, text: str) -> tuple[dict[str, Any], dict[Location, int]]:
    """Parse the text of a file as a mapping of keys, with their lines. Raises StudyError."""
    root = _compose(path, text)
    walker = _Walker(path)
    data = walker.plain(root, (), ())
    if walker.problems:
        raise StudyError(walker.problems)
    if not isinstance(data, dict):
        problem = Problem(path, 1, "", "a study is a mapping of keys", "begin with a line such as `name: my-study`")
        raise StudyError([problem])
    return data, walker.lines


def text_of_keys(definition: Mapping[str, Any], keys: Mapping[str, Any]) -> StudyText:
    """A study given in Python, as a dict and by name. Raises StudyError for what a study cannot hold."""
    giver = _Giver(_stand_in_path({**definition, **keys}))
    for key in sorted({*map(str, definition)} & {*keys}):
        giver.problem((key,), "given twice", "keep one of the two")
    return giver.source({**definition, **keys})


def changed(definition: Mapping[str, Any], changes: Mapping[str, Any], beside: StudyFolder) -> StudyText:
    """Change a study by dotted keys.

    Args:
        definition: Keys and values of the study.
        changes: New values by dotted key; None removes a key.
        beside: Folder of the files that the study names.

    Returns:
        The changed study as plain values.

    Raises:
        StudyError: A change contradicts another one or has no effect.
    """
    giver = _Giver(_stand_in_path({**definition, **changes}))
    data = dict(definition)
    changes = giver.keyed(changes, ())
    for key in changes:
        inside = next((other for other in changes if other.startswith(f"{key}.")), None)
        if inside is not None:
            giver.problem((inside,), f"given twice: here and within {key}", "keep one of the two")
    if giver.problems:
        raise StudyError(giver.problems)
    for key, value in changes.items():
        _put(data, key, value, giver)
    varied = _varied(data)
    for key in changes:
        if key in varied:
            problem = f"it is varied under {varied[key]}, so this changes nothing"
            giver.problem((key,), problem, f"change {varied[key]}, or remove it with None")
    return replace(giver.source(data), beside=beside.again())


def as_yaml(definition: Mapping[str, Any]) -> str:
    """Keys and values of a study as YAML: a section a line, unless it is long."""
    from ruamel.yaml import YAML

    writer, text = YAML(typ="safe", pure=True), StringIO()
    writer.default_flow_style, writer.width, writer.allow_unicode = None, 120, True
    writer.sort_base_mapping_type_on_output = False  # pyright: ignore[reportAttributeAccessIssue]
    writer.dump(dict(definition), text)
    return text.getvalue()


def _stand_in_path(data: Mapping[str, Any]) -> Path:
    """Name in place of the file, for messages on a study made in Python."""
    name = data.get("name")
    return Path(f"study {name}" if isinstance(name, str) and re.fullmatch(r"[\w-]{1,80}", name) else "study")


def _put(data: dict[str, Any], key: str, value: Any, giver: "_Giver") -> None:
    """Put a value in place in `data`, or take the key out; sections on the way are copied."""
    *sections, leaf = key.split(".")
    if sections and sections[0] == "sweep":  # whose keys have dots
        first, rest = (["sweep", "zip"], key.removeprefix("sweep.zip.")) if sections[1:2] == ["zip"] else (
            ["sweep"], key.removeprefix("sweep."))  # fmt: skip
        sections, leaf = first, rest
    for index, section in enumerate(sections):
        below = data.get(section, {})
        if not isinstance(below, Mapping):
            section_name = ".".join(sections[: index + 1])
            giver.problem((key,), f"{section_name} is not a section with keys", f"give {section_name} as a whole")
            return
        data[section] = dict(below)
        data = data[section]
    if value is None:
        data.pop(leaf, None)
    else:
        data[leaf] = value


def _varied(data: Mapping[str, Any]) -> dict[str, str]:
    """Keys that a study varies, and under what: a value stated for one elsewhere would be without effect."""
    varied: dict[str, str] = {}
    sweep, points = data.get("sweep"), data.get("points")
    if isinstance(points, list | tuple):
        varied |= {str(key): "points" for point in points if isinstance(point, Mapping) for key in point}
    if isinstance(sweep, Mapping):
        together = sweep.get("zip")
        varied |= {str(key): f"sweep.zip.{key}" for key in (together if isinstance(together, Mapping) else {})}
        varied |= {str(key): f"sweep.{key}" for key in sweep if key != "zip"}
    return varied


class _Giver:
    """Turns what Python holds into what YAML holds; notes what neither a study nor YAML can."""

    def __init__(self, path: Path):
        self.path, self.problems, self._values = path, list[Problem](), 0

    def source(self, data: Mapping[str, Any]) -> StudyText:
        """The study. Raises StudyError."""
        plain = self._mapping(data, ())
        if self.problems:
            raise StudyError(self.problems)
        return StudyText(self.path, plain)

    def problem(self, location: Location, message: str, remedy: str) -> None:
        """Note something that is wrong at a place."""
        self.problems.append(Problem(self.path, 0, quote(dotted(location)), message, remedy))

    def _plain(self, value: Any, location: Location) -> Any:
        self._values += 1
        if self._values > MAX_NODES or len(location) > MAX_DEPTH:
            remedy = "write long lists as sweeps, or split the study"
            raise StudyError([Problem(self.path, 0, quote(dotted(location)), "too many values, or too deep", remedy)])
        if value is None or type(value) in (str, bool, int, float):
            return value
        if isinstance(value, str):
            return str(value)  # such as a member of an enumeration of words
        if hasattr(value, "magnitude") and hasattr(value, "units"):  # a pint quantity
            several = getattr(value.magnitude, "ndim", 0)
            return [self._plain(one, location) for one in value] if several else _spelled(value)
        if hasattr(value, "tolist"):  # an array or a number of NumPy, a column of pandas
            return self._plain(value.tolist(), location)
        if isinstance(value, Mapping):
            return self._mapping(value, location)
        if isinstance(value, list | tuple | range):
            return [self._plain(one, (*location, index)) for index, one in enumerate(value)]
        message = f"a study cannot hold {quote(value)}, of the type {type(value).__name__}"
        self.problem(location, message, "give text, a number, true or false, a list or a dict")
        return None

    def keyed(self, value: Mapping[Any, Any], location: Location) -> dict[str, Any]:
        """Entries whose key is a text; other keys are noted as problems."""
        for key in value:
            if not isinstance(key, str):
                self.problem(location, f"{quote(key)} is not a key: keys are text", "write the key in quotes")
        return {key: one for key, one in value.items() if isinstance(key, str)}

    def _mapping(self, value: Mapping[Any, Any], location: Location) -> dict[str, Any]:
        return {key: self._plain(one, (*location, key)) for key, one in self.keyed(value, location).items()}


def _spelled(quantity: Any) -> str:
    """A pint quantity as a study writes it: all digits of the number, and its unit."""
    magnitude = getattr(quantity.magnitude, "item", lambda: quantity.magnitude)()
    unit = f"{quantity.units:~C}"
    return f"{magnitude!r} {unit.removeprefix('dimensionless')}".strip()


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
    except _TooMany as excess:
        message = f"more than {MAX_NODES} values"
        raise StudyError(
            [Problem(path, excess.line, "", message, "write long lists as sweeps, or split the study")]
        ) from None
    except RecursionError:
        raise StudyError([Problem(path, _deep(text), "", "nested too deeply", "use fewer levels")]) from None
    except Exception as error:  # a parser on arbitrary text: whatever stops it, the text is not YAML
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        line = mark.line + 1 if mark is not None else text.count("\n", 0, getattr(error, "position", 0)) + 1
        reason = error.problem if isinstance(error, MarkedYAMLError) and error.problem else "unreadable"
        message = f"not valid YAML: {quote(' '.join(str(reason).split()))}"
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
        line_number = text.count("\n", 0, strange.start()) + 1
        return f"remove the character {ord(strange[0]):#04x} on line {line_number}: it is not allowed in text"
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
            self.problems.append(self._problem(node, location, f"the tag {quote(tag)} is unknown", "leave the tag out"))
            return None
        try:
            return getattr(self._constructor, f"construct_yaml_{kind}")(node)
        except (ValueError, KeyError, IndexError, OverflowError):
            return text

    def _problem(self, node: Any, location: Location, message: str, remedy: str) -> Problem:
        return Problem(self.path, node.start_mark.line + 1, quote(dotted(location)), message, remedy)
