"""Notes and tags that people give to studies and runs: `lab/notes/studies/NAME.md` and `lab/notes/runs/KEY.md`.

A file is written to be edited by hand. Its first line may list tags, the rest is free text:

    tags: for-the-paper, slow

    The outlet clogged twice near the end; *seed 3* is worth a second look.

Notes are no part of any identity: to write one changes no key and no stamp.
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
"""Of a file with a note."""
MOST_TAGS = 20
LONGEST_TAG = 30
SUFFIX = ".md"
_FOLDERS: dict[Kind, str] = {"study": "studies", "run": "runs"}
_HEAD = re.compile(r"tags:(.*)", re.IGNORECASE)
_BEFORE = re.compile(r"\A(?:\ufeff|[ \t]*\n)+")
"""What is dropped at the beginning of a text: a byte order mark, empty lines."""
_ALLOWED = "a tag has letters, digits, - _ and . only"
_WHOLE = len(digest(None))
"""Digits of a whole key."""
_RUN_KEY = TypeAdapter(RunKey)


@dataclass(frozen=True)
class Note:
    """What people noted of a study or a run."""

    text: str = ""
    """Source in Markdown; empty lines at its beginning and white space at its end are not kept."""
    tags: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.text or self.tags)


def read(lab: LabFolder, kind: Kind, name: str) -> Note:
    """The note of the study or run `name`; an empty one if there is none.

    Raises LabError, which names the file, for one that cannot be read, and ValueError for a name that is none.
    """
    path = _found(lab, kind, name)
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
    """The note that a file holds. Raises ValueError that says what is wrong with it."""
    if len(content) > MOST_BYTES:
        raise ValueError(f"the note has more than {MOST_BYTES} bytes; shorten it")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError("the note is not text in UTF-8; save the file as UTF-8") from error
    first, _, rest = text.partition("\n")
    head = _HEAD.fullmatch(first.rstrip())
    if head is None:
        return Note(_trimmed(text))
    return Note(_trimmed(rest), checked(filter(None, map(str.strip, head[1].split(",")))))


def write(lab: LabFolder, kind: Kind, name: str, note: Note) -> None:
    """Keep a note in place of an earlier one; an empty note removes the file.

    Tags are sorted, and each is written once. Raises ValueError for a tag or text that cannot be kept and for a name
    that is none, LabError as `read` does for its name, and OSError.
    """
    path = _found(lab, kind, name)
    tags, text = checked(note.tags), _trimmed(note.text)
    try:
        content = _written(tags, text).encode()
    except UnicodeEncodeError as error:
        raise ValueError(f"character {error.start + 1} of the note is half of a surrogate pair; remove it") from error
    if len(content) > MOST_BYTES:
        raise ValueError(f"the note has {len(content)} bytes with its tags, and {MOST_BYTES} are allowed; shorten it")
    with lab.alone(f"note-{kind}-{name}"):
        if content:
            make_folder(path.parent)
            write_bytes(path, content)
            sync_folder(path.parent)
        else:
            with suppress(FileNotFoundError, NotADirectoryError):
                path.unlink()


def checked(tags: Iterable[str]) -> tuple[str, ...]:
    """Tags as they are kept: composed characters, each once, sorted. Raises ValueError that says what is allowed."""
    found = sorted({unicodedata.normalize("NFC", tag) for tag in tags})
    for tag in found:
        if not tag:
            raise ValueError(f"a tag is empty; {_ALLOWED}")
        if strange := next((one for one in tag if not _in_tags(one)), None):
            raise ValueError(f"the tag {tag!r} has the character {strange!r}; {_ALLOWED}")
        if len(tag) > LONGEST_TAG:
            raise ValueError(f"the tag {tag!r} has {len(tag)} characters; {LONGEST_TAG} are allowed")
    if len(found) > MOST_TAGS:
        raise ValueError(f"there are {len(found)} tags; {MOST_TAGS} are allowed")
    return tuple(found)


def tagged(lab: LabFolder, kind: Kind) -> dict[str, tuple[str, ...]]:
    """The tags of all studies or runs that have any, by name. Notes that cannot be read are left out: see `damaged`."""
    return {name: note.tags for name, note in _all(lab, kind) if isinstance(note, Note) and note.tags}


def damaged(lab: LabFolder, kind: Kind) -> list[str]:
    """Why notes cannot be read, or belong to no run, a line each that names the file."""
    found = [str(problem) for _, problem in _all(lab, kind) if isinstance(problem, LabError)]
    if kind == "run":
        keys = folders(lab.runs)
        for name, path in named(lab, kind).items() if keys else ():
            begun = sum(key.startswith(name) for key in keys)
            if len(name) < _WHOLE and name not in keys and begun != 1:
                many = f"the keys of {begun} runs begin so" if begun else "no run has a key that begins so"
                found.append(f"{path}: {many}; name the file by the whole key of the run")
    return found


def named(lab: LabFolder, kind: Kind) -> dict[str, Path]:
    """Whatever is named like a note of a study or run, by that name, in order; it may be damaged. The name of a run's
    file may be the beginning of its key, as `labbook runs` prints it; one that several runs have stays as it is."""
    files = _files(lab, kind)
    if kind == "run" and any(not lab.run(name).exists() for name in files):
        keys = folders(lab.runs)
        for name in [name for name in files if not lab.run(name).exists()]:
            begun = [key for key in keys if key.startswith(name)]
            if len(begun) == 1 and begun[0] not in files:
                files[begun[0]] = files.pop(name)
    return files


def _files(lab: LabFolder, kind: Kind) -> dict[str, Path]:
    try:
        paths = sorted(path for path in folder(lab, kind).iterdir() if path.suffix == SUFFIX)
    except (FileNotFoundError, NotADirectoryError):
        return {}
    return {path.stem: path for path in paths if _is_name(kind, path.stem)}


def _found(lab: LabFolder, kind: Kind, name: str) -> Path:
    """Where the note of a study or run lies: of a run, also under the beginning of its key. Raises ValueError for what
    is no name of one, and LabError for a beginning that several keys have."""
    path = place(lab, kind, name)
    if kind == "study" or os.path.lexists(path):
        return path
    for short, file in _files(lab, kind).items():
        if name.startswith(short):
            begun = [key for key in folders(lab.runs) if key.startswith(short)]
            if len(begun) > 1:
                raise LabError(f"{file}: the keys of {len(begun)} runs begin so; give the file more digits of the key")
            return file
    return path


def folder(lab: LabFolder, kind: Kind) -> Path:
    """Where notes of studies or runs lie."""
    return lab.notes / _FOLDERS[kind]


def place(lab: LabFolder, kind: Kind, name: str) -> Path:
    """Where the note of the study or run `name` lies. Raises ValueError for what is no name of one."""
    if not _is_name(kind, name):
        wanted = "8 to 64 digits and letters a to f" if kind == "run" else "letters, digits, - and _"
        raise ValueError(f"{name!r} does not name a {kind}: {wanted} are needed")
    return folder(lab, kind) / f"{name}{SUFFIX}"


def _is_name(kind: Kind, name: str) -> bool:
    if kind == "study":
        return names_a_study(name)
    try:
        _RUN_KEY.validate_python(name)
    except ValidationError:
        return False
    return True


def _in_tags(character: str) -> bool:
    """Whether tags may have a character: letters of any script with their marks, digits, and few others."""
    return character in "-_." or unicodedata.category(character)[0] in "LM" or unicodedata.category(character) == "Nd"


def _trimmed(text: str) -> str:
    return _BEFORE.sub("", re.sub(r"\r\n?", "\n", text)).rstrip()


def _written(tags: tuple[str, ...], text: str) -> str:
    """A file with tags and text; without tags it has a line for them only if the text begins like one."""
    lines = [text] if text else []
    if tags or _HEAD.match(text):
        lines = [f"tags: {', '.join(tags)}".rstrip(), *(["", text] if text else [])]
    return "".join(f"{line}\n" for line in lines)


def _all(lab: LabFolder, kind: Kind) -> Iterator[tuple[str, Note | LabError]]:
    for name in named(lab, kind):
        try:
            yield name, read(lab, kind, name)
        except LabError as problem:
            yield name, problem
