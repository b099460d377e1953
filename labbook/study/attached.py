"""Text files beside a study that it names, such as measurements: how they are read, and how a lab keeps them.

A lab keeps the files of the study NAME in `study-files/NAME.files.json`, each with a hash of its text.
"""

import errno
import json
import os
import stat
from collections.abc import Mapping
from hashlib import blake2b
from pathlib import Path, PurePosixPath

COPY = ".files.json"
"""End of the name of the file that holds the files of a study, in place of .yaml."""
LARGEST = 2_000_000
"""Size of a file [bytes] above which it is refused."""
LARGEST_COPY = 4 * LARGEST
"""The same of the file that a lab keeps: JSON escapes some characters."""


def read(study: Path, name: str) -> str:
    """Read a file that a study names: the one beside the study, else the copy that a lab keeps with the study.

    Args:
        study: Path of the study's file.
        name: As the study names it: relative, without links and without a way out of its folder.

    Returns:
        The text of the file.

    Raises:
        ValueError: The name is not allowed, or the file cannot be read; the message says why.
    """
    parts = PurePosixPath(name).parts
    if not parts or name.startswith(("/", "~")) or ".." in parts or "\\" in name or "\0" in name:
        raise ValueError("the file has to be in the folder of the study or below it")
    folder = study.parent
    for depth in range(len(parts)):
        if folder.joinpath(*parts[: depth + 1]).is_symlink():
            raise ValueError("it is a link, or behind one")
    try:
        content = _content(folder.joinpath(*parts))
    except FileNotFoundError:
        copies = copies_of(study)
        if name not in copies:
            raise ValueError("there is no such file beside the study") from None
        return copies[name]
    except OSError as error:
        raise ValueError(error.strerror or str(error)) from None
    return _decoded(content)


def copies_of(study: Path) -> dict[str, str]:
    """Read the files that a lab keeps with a study, by name; none where it keeps none.

    Raises:
        ValueError: They cannot be read, or a text does not fit its hash.
    """
    path = study.with_suffix(COPY)
    try:
        content = _content(path, LARGEST_COPY)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from None
    try:
        texts = {name: (one["text"], one["hash"]) for name, one in json.loads(_decoded(content)).items()}
        changed = [name for name, (text, seal) in texts.items() if _hash(text) != seal]
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{path}: not the files of a study ({error})") from None
    if changed:
        raise ValueError(f"{path}: {changed[0]} was changed after it was kept; run the study again from its own folder")
    return {name: text for name, (text, _) in texts.items()}


def sealed(files: Mapping[str, str]) -> str:
    """Write files of a study, by name, as a lab keeps them."""
    return json.dumps({name: {"hash": _hash(text), "text": text} for name, text in files.items()}, indent=1) + "\n"


def save(path: Path, text: str) -> None:
    """Write a file beside a study, unless it is there already. Raises FileExistsError for one with another text."""
    try:
        if _decoded(_content(path)) == text:
            return
    except FileNotFoundError:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return
    except ValueError:
        pass
    raise FileExistsError(errno.EEXIST, "another file of this name is there", str(path))


def _content(path: Path, limit: int = LARGEST) -> bytes:
    """The bytes of an ordinary file. Raises OSError, and ValueError for anything else or one that is too large."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
    with os.fdopen(handle, "rb") as file:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise ValueError("it is not an ordinary file")
        content = file.read(limit + 1)
    if len(content) > limit:
        raise ValueError(f"it is larger than {limit / 1e6:g} MB")
    return content


def _decoded(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError("it is not text in UTF-8") from None


def _hash(text: str) -> str:
    return blake2b(text.encode(), digest_size=16).hexdigest()
