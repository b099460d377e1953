"""The texts of the studies that were run in a lab, as their authors wrote them: `lab/study-files/NAME.yaml`.

A text is that of the last run under its name. The calibration by which numerics were chosen, where a study has one of
its own, lies beside it, and so does a list of the files that it names; the content of these is in `lab/attached`.
Nothing here reads what they say: `labbook.study.load` does.
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
    """Keep `text` as that of the study `name`, and the file of its own calibration beside it, in place of earlier ones;
    and the list of its attached `files`, hashes by name. The same is not written again.

    Raises ValueError for a name that no study may have, and OSError.
    """
    path, content = place(lab, name), text.encode()
    measured = None if calibration is None else calibration.read_bytes()
    with lab.alone(f"study-{name}"):  # several processes may begin the same study
        if _content(path) != content:
            _write(lab, path, content)
        _keep_beside(lab, path.with_suffix(BESIDE), measured)
        listed = json.dumps(dict(files), indent=1).encode() if files else None
        _keep_beside(lab, path.with_suffix(attached.LIST), listed)


def attach(lab: LabFolder, keys: Iterable[str]) -> None:
    """Keep the contents of attached files, by hash, in the lab. Raises OSError, and AttachedError for a content that
    is nowhere."""
    for key in keys:
        if not _is_attached(lab, key):
            _attach(lab, key, attached.content(key))


def attach_content(lab: LabFolder, content: bytes) -> None:
    """Keep the content of an attached file of another lab. Raises OSError."""
    if not _is_attached(lab, key := attached.key_of(content)):
        _attach(lab, key, content)


def _is_attached(lab: LabFolder, key: str) -> bool:
    content = _content(lab.attached / key)
    return content is not None and attached.key_of(content) == key


def _attach(lab: LabFolder, key: str, content: bytes) -> None:
    make_folder(lab.attached)
    write_bytes(lab.attached / key, content)
    sync_folder(lab.attached)


def add(lab: LabFolder, name: str, text: str, calibration: str | None = None, files: str | None = None) -> str | None:
    """Keep `text` as that of the study `name`, the text of its own calibration, and the list of its files, unless the
    lab has such a study.

    Returns the text that the lab had, or None. Raises ValueError for a name that no study may have, and OSError.
    """
    path, content = place(lab, name), text.encode()
    with lab.alone(f"study-{name}"):
        had = _content(path)
        if had is None:
            _write(lab, path, content)
            _keep_beside(lab, path.with_suffix(BESIDE), None if calibration is None else calibration.encode())
            _keep_beside(lab, path.with_suffix(attached.LIST), None if files is None else files.encode())
        return None if had is None else had.decode(errors="replace")


def calibration(lab: LabFolder, path: Path) -> Path | None:
    """The file of the calibration that is kept beside that of a study in the lab; None if there is none."""
    beside = path.with_suffix(BESIDE)
    return beside if path.parent == lab.studies and _is_own(beside) else None


def kept(lab: LabFolder) -> dict[str, Path]:
    """The files of all studies that are kept, by name, in the order of their names. Links are none of them: in a lab
    that came from elsewhere they may lead to any file."""
    return {name: path for name, path in named(lab).items() if _is_own(path)}


def _is_own(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()


def place(lab: LabFolder, name: str) -> Path:
    """Where the text of the study `name` is kept. Raises ValueError for a name that no study may have."""
    if not names_a_study(name):
        raise ValueError(f"{name!r} is not the name of a study: letters, digits, - and _, beginning with a letter")
    return lab.studies / f"{name}{SUFFIX}"


def named(lab: LabFolder) -> dict[str, Path]:
    """Whatever is named like the file of a study, also links and folders, by name, in the order of their names."""
    try:
        paths = sorted(path for path in lab.studies.iterdir() if path.suffix == SUFFIX)
    except (FileNotFoundError, NotADirectoryError):
        return {}
    return {path.stem: path for path in paths if names_a_study(path.stem)}


def _content(path: Path) -> bytes | None:
    """What is in a file; None if there is none that can be read."""
    try:
        with open_file(path) as file:
            return file.read()
    except OSError:
        return None


def _keep_beside(lab: LabFolder, path: Path, content: bytes | None) -> None:
    if content is None:
        remove(path)
    elif _content(path) != content:
        _write(lab, path, content)


def _write(lab: LabFolder, path: Path, content: bytes) -> None:
    make_folder(lab.studies)
    write_bytes(path, content)
    sync_folder(lab.studies)
