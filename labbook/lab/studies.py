"""The texts of the studies that were run in a lab, as their authors wrote them: `lab/study-files/NAME.yaml`.

A text is that of the last run under its name. The calibration by which numerics were chosen, where a study has one of
its own, lies beside it, and so do the files that it names. Nothing here reads what they say: `labbook.study.load` does.
"""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from labbook.accuracy import BESIDE
from labbook.lab.folder import LabFolder, make_folder, open_file, remove, sync_folder, write_bytes
from labbook.study.attached import COPY, sealed
from labbook.study.schema import names_a_study

SUFFIX = ".yaml"


def keep(
    lab: LabFolder,
    name: str,
    text: str,
    calibration: Path | None = None,
    files: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Keep `text` as that of the study `name`, and beside it the file of its own calibration and the texts of the
    `files` that it names, in place of earlier ones. The same is not written again.

    Raises ValueError for a name that no study may have, and OSError.
    """
    path, content = place(lab, name), text.encode()
    measured = None if calibration is None else calibration.read_bytes()
    with lab.alone(f"study-{name}"):  # several processes may begin the same study
        if _content(path) != content:
            _write(lab, path, content)
        _keep_beside(lab, path.with_suffix(BESIDE), measured)
        _keep_beside(lab, path.with_suffix(COPY), sealed(files).encode() if files else None)


def add(lab: LabFolder, name: str, text: str, calibration: str | None = None, files: str | None = None) -> str | None:
    """Keep `text` as that of the study `name`, the text of its own calibration and that of the files that it names, as
    a lab keeps them, unless the lab has such a study.

    Returns the text that the lab had, or None. Raises ValueError for a name that no study may have, and OSError.
    """
    path, content = place(lab, name), text.encode()
    with lab.alone(f"study-{name}"):
        had = _content(path)
        if had is None:
            _write(lab, path, content)
            for end, beside in ((BESIDE, calibration), (COPY, files)):
                _keep_beside(lab, path.with_suffix(end), None if beside is None else beside.encode())
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
