"""Texts of the studies that were run in a lab, as their authors wrote them: `lab/study-files/NAME.yaml`.

The text is that of the last run under its name. Beside it are the study's own calibration, if it has one, and a list of
the files that it names; the content of these is in `lab/attached`. This module does not parse studies:
`labbook.study.load` does.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

from labbook.accuracy import BESIDE
from labbook.lab.folder import LabFolder, make_folder, open_file, remove, sync_folder, write_bytes
from labbook.scene import attached
from labbook.study.schema import names_a_study

SUFFIX = ".yaml"


def keep(
    lab: LabFolder, name: str, text: str, calibration: Path | None = None, files: Mapping[str, str] | None = None
) -> None:
    """Store the text of a study, in place of an earlier one; an equal text is not written again.

    Args:
        lab: Folder of the lab.
        name: Name of the study.
        text: YAML text.
        calibration: File of the study's own calibration, which is copied.
        files: Hashes of its attached files, by name.

    Raises:
        ValueError: No study may have this name.
        OSError: The disk is full, or not writable.
    """
    path, content = study_path(lab, name), text.encode()
    calibration_text = None if calibration is None else calibration.read_bytes()
    with lab.alone(f"study-{name}"):  # several processes may begin the same study
        if _content(path) != content:
            _write(lab, path, content)
        _keep_beside(lab, path.with_suffix(BESIDE), calibration_text)
        listed = json.dumps(dict(files), indent=1).encode() if files else None
        _keep_beside(lab, path.with_suffix(attached.LIST), listed)


def attach(lab: LabFolder, keys: Iterable[str]) -> None:
    """Store the contents of attached files, by hash. Raises OSError, and AttachedError for a content that cannot be
    found."""
    for key in keys:
        if not _is_attached(lab, key):
            _attach(lab, key, attached.content(key))


def attach_content(lab: LabFolder, content: bytes) -> None:
    """Store the content of an attached file of another lab. Raises OSError."""
    if not _is_attached(lab, key := attached.key_of(content)):
        _attach(lab, key, content)


def _is_attached(lab: LabFolder, key: str) -> bool:
    # The content is hashed, not only looked for: a damaged copy is then written again.
    content = _content(lab.attached / key)
    return content is not None and attached.key_of(content) == key


def _attach(lab: LabFolder, key: str, content: bytes) -> None:
    make_folder(lab.attached)
    write_bytes(lab.attached / key, content)
    sync_folder(lab.attached)


def add(lab: LabFolder, name: str, text: str, calibration: str | None = None, files: str | None = None) -> str | None:
    """Store the text of a study, its calibration and its list of files, unless the lab has a study of this name.

    Returns:
        The text that the lab had before; None if it was stored now.

    Raises:
        ValueError: No study may have this name.
        OSError: The disk is full, or not writable.
    """
    path, content = study_path(lab, name), text.encode()
    with lab.alone(f"study-{name}"):  # of two imports at once both would find no text
        stored = _content(path)
        if stored is None:
            _write(lab, path, content)
            _keep_beside(lab, path.with_suffix(BESIDE), None if calibration is None else calibration.encode())
            _keep_beside(lab, path.with_suffix(attached.LIST), None if files is None else files.encode())
        return None if stored is None else stored.decode(errors="replace")


def calibration(lab: LabFolder, path: Path) -> Path | None:
    """Return the file of the calibration that is stored beside that of a study; None if there is none."""
    beside = path.with_suffix(BESIDE)
    return beside if path.parent == lab.studies and _is_ordinary(beside) else None


def study_files(lab: LabFolder) -> dict[str, Path]:
    """Return the files of all stored studies, by name, sorted.

    Links are left out: in a lab that came from elsewhere they could show any file.
    """
    return {name: path for name, path in candidates(lab).items() if _is_ordinary(path)}


def _is_ordinary(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()


def study_path(lab: LabFolder, name: str) -> Path:
    """Return the path of the text of the study `name`. Raises ValueError if no study may have this name."""
    if not names_a_study(name):
        raise ValueError(f"{name!r} is not the name of a study: letters, digits, - and _, beginning with a letter")
    return lab.studies / f"{name}{SUFFIX}"


def candidates(lab: LabFolder) -> dict[str, Path]:
    """Return all paths with the name of a study file, links and folders too, by name, sorted."""
    try:
        paths = sorted(path for path in lab.studies.iterdir() if path.suffix == SUFFIX)
    except (FileNotFoundError, NotADirectoryError):
        return {}
    return {path.stem: path for path in paths if names_a_study(path.stem)}


def _content(path: Path) -> bytes | None:
    """Content of a file; None if it cannot be read."""
    try:
        with open_file(path) as file:
            return file.read()
    except OSError:
        return None


def _keep_beside(lab: LabFolder, path: Path, content: bytes | None) -> None:
    if content is None:  # what an earlier text of this name had beside it must not count for the new one
        remove(path)
    elif _content(path) != content:
        _write(lab, path, content)


def _write(lab: LabFolder, path: Path, content: bytes) -> None:
    make_folder(lab.studies)
    write_bytes(path, content)
    sync_folder(lab.studies)
