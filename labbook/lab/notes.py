"""Notes and tags that people give to studies and runs: `lab/notes/studies/NAME.md` and `lab/notes/runs/KEY.md`.

A file can be edited by hand. Its first line may list tags, the rest is free text:

    tags: for-the-paper, slow

    The outlet clogged twice near the end; *seed 3* is worth a second look.

Notes are no part of any identity: writing one changes no key and no stamp.
"""

import os
import re
import unicodedata
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from labbook.lab.folder import LabError, LabFolder, folders, make_folder, open_file, sync_folder, write_bytes
from labbook.lab.records import RunKey
from labbook.scene.model import digest
from labbook.study.schema import names_a_study

Kind = Literal["study", "run"]

MOST_BYTES = 64_000
"""Maximum size of a file with a note."""
MOST_TAGS = 20
LONGEST_TAG = 30
SUFFIX = ".md"
_FOLDERS: dict[Kind, str] = {"study": "studies", "run": "runs"}
_TAG_LINE = re.compile(r"tags:(.*)", re.IGNORECASE)
_LEADING_BLANK = re.compile(r"\A(?:\ufeff|[ \t]*\n)+")
"""Start of a text that is dropped: a byte order mark, empty lines."""
_TAG_RULE = "a tag has letters, digits, - _ and . only"
_KEY_LENGTH = len(digest(None))
"""Digits of a complete key."""
_RUN_KEY = TypeAdapter(RunKey)


@dataclass(frozen=True)
class Note:
    """Note on a study or a run."""

    text: str = ""
    """Markdown source, without leading empty lines and trailing white space."""
    tags: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.text or self.tags)


def read(lab: LabFolder, kind: Kind, name: str) -> Note:
    """Read the note on the study or run `name`; an empty one if there is none.

    Raises:
        LabError: The file cannot be read; the message names it.
        ValueError: `name` cannot be the name of a study or run.
    """
    path = _find_path(lab, kind, name)
    try:
        with open_file(path) as file:
            content = file.read(MOST_BYTES + 1)
    except (FileNotFoundError, NotADirectoryError):
        return Note()
    except OSError as error:
        raise LabError(f"{path}: the note cannot be read: {error.strerror}") from error
    try:
        return parsed(content)
    except ValueError as problem:
        raise LabError(f"{path}: {problem}") from problem


def parsed(content: bytes) -> Note:
    """Parse the content of a note file. Raises ValueError with the reason."""
    if len(content) > MOST_BYTES:
        raise ValueError(f"the note has more than {MOST_BYTES} bytes; shorten it")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError("the note is not text in UTF-8; save the file as UTF-8") from error
    first, _, rest = text.partition("\n")
    head = _TAG_LINE.fullmatch(first.rstrip())
    if head is None:
        return Note(_trim(text))
    return Note(_trim(rest), checked(filter(None, map(str.strip, head[1].split(",")))))


def write(lab: LabFolder, kind: Kind, name: str, note: Note) -> None:
    """Write a note in place of an earlier one; an empty note removes the file. Tags are sorted and made unique.

    Raises:
        ValueError: A tag or the text is not allowed, or `name` cannot be the name of a study or run.
        LabError: `name` matches a file whose short key several runs share.
        OSError: The file cannot be written.
    """
    path = _find_path(lab, kind, name)
    tags, text = checked(note.tags), _trim(note.text)
    try:
        content = _as_file(tags, text).encode()
    except UnicodeEncodeError as error:
        raise ValueError(f"character {error.start + 1} of the note is half of a surrogate pair; remove it") from error
    if len(content) > MOST_BYTES:
        raise ValueError(f"the note has {len(content)} bytes with its tags, and {MOST_BYTES} are allowed; shorten it")
    with lab.alone(f"note-{kind}-{name}"):  # two pages may save the same note at once
        if content:
            make_folder(path.parent)
            write_bytes(path, content)
            sync_folder(path.parent)
        else:
            with suppress(FileNotFoundError, NotADirectoryError):
                path.unlink()


def checked(tags: Iterable[str]) -> tuple[str, ...]:
    """Normalise tags: composed characters (NFC), unique, sorted. Raises ValueError with the rule that a tag
    violates."""
    # One letter may be one character, or a letter and a mark: by eye they are the same tag.
    unique_tags = sorted({unicodedata.normalize("NFC", tag) for tag in tags})
    for tag in unique_tags:
        if not tag:
            raise ValueError(f"a tag is empty; {_TAG_RULE}")
        if invalid := next((character for character in tag if not _is_allowed_in_tags(character)), None):
            raise ValueError(f"the tag {tag!r} has the character {invalid!r}; {_TAG_RULE}")
        if len(tag) > LONGEST_TAG:
            raise ValueError(f"the tag {tag!r} has {len(tag)} characters; {LONGEST_TAG} are allowed")
    if len(unique_tags) > MOST_TAGS:
        raise ValueError(f"there are {len(unique_tags)} tags; {MOST_TAGS} are allowed")
    return tuple(unique_tags)


def tagged(lab: LabFolder, kind: Kind) -> dict[str, tuple[str, ...]]:
    """Tags of all studies or runs that have any, by name. Unreadable notes are left out (see `damaged`)."""
    return {name: note.tags for name, note in _iter_notes(lab, kind) if isinstance(note, Note) and note.tags}


def damaged(lab: LabFolder, kind: Kind) -> list[str]:
    """Problems of notes that cannot be read, or whose file name matches no single run; each names the file."""
    problems = [str(problem) for _, problem in _iter_notes(lab, kind) if isinstance(problem, LabError)]
    if kind == "run":
        keys = folders(lab.runs)
        for name, path in candidates(lab, kind).items() if keys else ():
            matches = sum(key.startswith(name) for key in keys)
            if len(name) < _KEY_LENGTH and name not in keys and matches != 1:
                reason = f"the keys of {matches} runs begin so" if matches else "no run has a key that begins so"
                problems.append(f"{path}: {reason}; name the file by the whole key of the run")
    return problems


def candidates(lab: LabFolder, kind: Kind) -> dict[str, Path]:
    """Paths with the name of a note, by the name of the study or run, sorted; their content may be damaged.

    A short key in a file name, as `labbook runs` prints it, is completed if it matches exactly one run.
    """
    files = _files(lab, kind)
    if kind == "run" and any(not lab.run(name).exists() for name in files):
        keys = folders(lab.runs)
        for name in [name for name in files if not lab.run(name).exists()]:
            matches = [key for key in keys if key.startswith(name)]
            if len(matches) == 1 and matches[0] not in files:
                files[matches[0]] = files.pop(name)
    return files


def _files(lab: LabFolder, kind: Kind) -> dict[str, Path]:
    try:
        paths = sorted(path for path in folder(lab, kind).iterdir() if path.suffix == SUFFIX)
    except (FileNotFoundError, NotADirectoryError):
        return {}
    return {path.stem: path for path in paths if _is_name(kind, path.stem)}


def _find_path(lab: LabFolder, kind: Kind, name: str) -> Path:
    """Path of the note on a study or run; for a run also a file named by the beginning of its key.

    Raises:
        ValueError: `name` cannot be the name of a study or run.
        LabError: The beginning of the key matches several runs.
    """
    path = note_path(lab, kind, name)
    if kind == "study" or os.path.lexists(path):
        return path
    for short, file in _files(lab, kind).items():
        if name.startswith(short):
            matches = [key for key in folders(lab.runs) if key.startswith(short)]
            if len(matches) > 1:
                raise LabError(
                    f"{file}: the keys of {len(matches)} runs begin so; give the file more digits of the key"
                )
            return file
    return path


def folder(lab: LabFolder, kind: Kind) -> Path:
    """Folder of the notes on studies or runs."""
    return lab.notes / _FOLDERS[kind]


def note_path(lab: LabFolder, kind: Kind, name: str) -> Path:
    """Path of the note on the study or run `name`. Raises ValueError if it cannot be the name of one."""
    if not _is_name(kind, name):
        rule = "8 to 64 digits and letters a to f" if kind == "run" else "letters, digits, - and _"
        raise ValueError(f"{name!r} does not name a {kind}: {rule} are needed")
    return folder(lab, kind) / f"{name}{SUFFIX}"


def _is_name(kind: Kind, name: str) -> bool:
    if kind == "study":
        return names_a_study(name)
    try:
        _RUN_KEY.validate_python(name)
    except ValidationError:
        return False
    return True


def _is_allowed_in_tags(character: str) -> bool:
    """Decide whether tags may have a character: letters of any script with their marks, digits, `-`, `_`, `.`."""
    return character in "-_." or unicodedata.category(character)[0] in "LM" or unicodedata.category(character) == "Nd"


def _trim(text: str) -> str:
    return _LEADING_BLANK.sub("", re.sub(r"\r\n?", "\n", text)).rstrip()


def _as_file(tags: tuple[str, ...], text: str) -> str:
    """Content of a note file. Without tags there is a line for them only if the text begins like one."""
    lines = [text] if text else []
    if tags or _TAG_LINE.match(text):
        lines = [f"tags: {', '.join(tags)}".rstrip(), *(["", text] if text else [])]
    return "".join(f"{line}\n" for line in lines)


def _iter_notes(lab: LabFolder, kind: Kind) -> Iterator[tuple[str, Note | LabError]]:
    for name in candidates(lab, kind):
        try:
            yield name, read(lab, kind, name)
        except LabError as problem:
            yield name, problem
