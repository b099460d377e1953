"""Files beside a study whose content decides what is simulated, such as positions of grains or a mesh.

A study names such a file by its path within the study's folder. Models, keys and records hold the SHA-256 of its
content and nothing else. The content is read where it is needed: from the file, or from the copy in a lab
(`lab/attached/SHA256`).
"""

import hashlib
import json
import os
import re
import stat
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationInfo
from pydantic_core import PydanticCustomError

MOST_BYTES = 64_000_000
"""Size of the largest file that may be attached."""
LIST = ".files.json"
"""Suffix of the list of a study's files in a lab, in place of the suffix of the study: their names and hashes."""
_MOST_LISTED = 1_000_000  # bytes of such a list
_MOST_FOLDERS = 100
_SHA256 = re.compile(r"[0-9a-f]{64}")

_paths: dict[str, Path] = {}
_names: dict[str, str] = {}
_contents: dict[str, bytes] = {}
_folders: dict[Path, None] = {}


class AttachedError(ValueError):
    """A file cannot be attached, or its content is not there; the message says which and why."""

    def __init__(self, reason: str, remedy: str):
        super().__init__(f"{reason}; {remedy}")
        self.reason, self.remedy = reason, remedy

    def __reduce__(self):
        return AttachedError, (self.reason, self.remedy)


@dataclass
class StudyFolder:
    """Folder of a study, below which its files are, and the files that were attached so far."""

    folder: Path = Path()
    listed: Mapping[str, str] = field(default_factory=dict)
    """Hashes by name of files of a study in a lab, which has their content by hash."""
    files: dict[str, str] = field(default_factory=dict)
    """Hashes of the attached files by their names in the study."""

    @classmethod
    def of(cls, study: Path) -> "StudyFolder":
        """Find the folder of a study file, which may be the copy in a lab.

        Args:
            study: Study file.

        Returns:
            Folder, with the hashes of the study's files if it lies in a lab.
        """
        try:
            content = _read(study.with_suffix(LIST), _MOST_LISTED)
            listed = json.loads(content)
        except (OSError, ValueError):
            return cls(study.parent)
        if not isinstance(listed, dict):
            return cls(study.parent)
        search(study.parent.parent / "attached")
        return cls(study.parent, {str(name): str(key) for name, key in listed.items() if is_hash(key)})

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Find the files again in another process of this machine."""
        self.__dict__.update(state)
        if self.listed:
            search(self.folder.parent / "attached")
        for file, key in self.files.items():
            _names[key] = file
            _paths.setdefault(key, (self.folder / file).absolute())

    def again(self) -> "StudyFolder":
        """Make the same folder again, to attach files as they are now."""
        return StudyFolder(self.folder, self.listed)

    def attach(self, name: str) -> str:
        """Attach a file, which is read once.

        Args:
            name: Its path within the folder of the study, as the study states it.

        Returns:
            SHA-256 of its content, 64 hexadecimal digits.

        Raises:
            AttachedError: There is no such file, it is a link or lies in one, it lies outside the folder, or it has
                more than `MOST_BYTES`.
        """
        if name not in self.files:
            self.files[name] = self._attach(name)
            _names[self.files[name]] = name
        return self.files[name]

    def copy(self, folder: Path) -> None:
        """Write the attached files below another folder.

        Args:
            folder: That folder.

        Raises:
            FileExistsError: Another file has the name of one of them.
            AttachedError: The content of a file is gone.
        """
        for file, key in self.files.items():
            path, copied = folder / file, content(key)
            if not path.exists():
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(copied)
            elif path.read_bytes() != copied:
                raise FileExistsError(f"{path} is another file than the one that the study names")

    def _attach(self, name: str) -> str:
        inside = PurePosixPath(name)
        if inside.is_absolute() or ".." in inside.parts or name != str(inside) or "\0" in name:
            reason = f"{name} is not a path within the folder of the study"
            raise AttachedError(reason, "copy the file beside the study, and state its name, such as grains.csv")
        path = self.folder / inside
        if name in self.listed and not os.path.lexists(path):
            return self.listed[name]
        for step in (path, *path.parents[: len(inside.parts) - 1]):
            if step.is_symlink():
                raise AttachedError(f"{name}: {step} is a link", "use a copy: labbook follows no links beside a study")
        try:
            content = _read(path, MOST_BYTES)
        except OSError as error:
            reason = f"{path} cannot be read: {error.strerror or error}"
            raise AttachedError(reason, "state a file in the folder of the study") from None
        key = key_of(content)
        _paths[key] = path.absolute()
        return key


def _attached(value: Any, info: ValidationInfo) -> Any:
    """Hash of a file, from its name where a study states it."""
    context = info.context or {}
    if context.get("units") != "required" or not isinstance(value, str):
        return value
    beside = context.get("beside") or StudyFolder()
    try:
        return beside.attach(value)
    except AttachedError as problem:
        details = {"reason": problem.reason, "remedy": problem.remedy}
        raise PydanticCustomError("attached", "{reason}", details) from None


AttachedFile = Annotated[str, BeforeValidator(_attached), Field(pattern=r"^[0-9a-f]{64}$")]
"""Field of a model: in a study the name of a file beside it, in the model the SHA-256 of its content."""


def is_hash(key: Any) -> bool:
    """True for the text of a SHA-256."""
    return isinstance(key, str) and _SHA256.fullmatch(key) is not None


def search(folder: Path) -> None:
    """Look for contents in `folder`, too, by files that are called by their hashes; in the last folders first."""
    _folders.pop(folder, None)
    _folders[folder] = None
    while len(_folders) > _MOST_FOLDERS:
        _folders.pop(next(iter(_folders)))


def registered() -> tuple[dict[str, Path], tuple[Path, ...]]:
    """Files by their hashes, and folders that are searched, for another process of this machine."""
    return dict(_paths), tuple(folder.absolute() for folder in _folders)


def use(remote: tuple[dict[str, Path], tuple[Path, ...]]) -> None:
    """Search the `registered` of another process."""
    paths, folders = remote
    _paths.update(paths)
    for folder in folders:
        search(folder)


def add(content: bytes) -> str:
    """Hold a content in memory, as of a file that lies on another machine, and return its hash."""
    key = key_of(content)
    _contents[key] = content
    return key


def name(key: str) -> str:
    """Name of a file for people: as a study states it, or the beginning of its hash."""
    return _names.get(key, f"attached file {key[:12]}")


def content(key: str) -> bytes:
    """Read the content of an attached file as it was when it was attached.

    Args:
        key: SHA-256 of the content.

    Returns:
        Content.

    Raises:
        AttachedError: No file with this content is left beside the study or in a lab in use.
    """
    if key in _contents:
        return _contents[key]
    for path in _candidate_paths(key):
        try:
            read = _read(path, MOST_BYTES)
        except OSError:
            continue
        if key_of(read) == key:
            return read
    where = f"{_paths[key]} was changed or removed" if key in _paths else f"{key} lies in no lab that is in use"
    raise AttachedError(f"{name(key)}: {where}, and no copy is left", "put the file back, and give the command again")


def contents(keys: Iterable[str]) -> dict[str, bytes]:
    """Read contents for another machine.

    Args:
        keys: SHA-256 of each content.

    Returns:
        Contents by hash.

    Raises:
        AttachedError: A content is gone.
    """
    return {key: content(key) for key in keys}


def _candidate_paths(key: str) -> Iterable[Path]:
    if not is_hash(key):
        return
    if key in _paths:
        yield _paths[key]
    yield from (folder / key for folder in reversed(list(_folders)))


def key_of(content: bytes) -> str:
    """SHA-256 of a content."""
    return hashlib.sha256(content).hexdigest()


def _read(path: Path, limit: int) -> bytes:
    """Content of an ordinary file, which is no link. Raises OSError."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
    with os.fdopen(handle, "rb") as file:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise OSError("it is not an ordinary file")
        if status.st_size > limit:
            raise OSError(f"it has {status.st_size:,} bytes, more than {limit:,}")
        return file.read(limit + 1)
