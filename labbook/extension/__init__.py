"""A package to begin an extension with: a contact law, a measure, a verification case, a test and a study."""

import keyword
import re
import sys
from collections.abc import Iterator
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

NAME = "my-extension"
"""Name of the template; its package is `my_extension`."""


class PackageNotWritten(Exception):
    """The package was not written; the message says why and what to do."""


def write(name: str, folder: Path) -> Path:
    """Write a package called `name` to `folder`/`name`.

    Args:
        name: Name of the distribution: small letters, digits and -.
        folder: The folder that gets the new one.

    Returns:
        The new folder.

    Raises:
        PackageNotWritten: No package can have this name, the folder exists, or it cannot be written.
    """
    package = name.replace("-", "_")
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name):
        raise PackageNotWritten(
            f"{name!r} cannot be the name of a package: use small letters, digits and -, a letter first"
        )
    if keyword.iskeyword(package) or package in sys.stdlib_module_names or package.partition("_")[0] == "labbook":
        raise PackageNotWritten(f"{name} is a name of Python or of labbook: choose another one")
    target = folder / name
    try:
        target.mkdir()
        for inner_path, text in _texts(files(__name__) / "template", Path()):
            renamed = text.replace(NAME, name).replace(NAME.replace("-", "_"), package)
            path = target / str(inner_path).replace(NAME.replace("-", "_"), package)
            path.parent.mkdir(exist_ok=True)
            path.write_text(renamed, encoding="utf-8")
    except FileExistsError:
        raise PackageNotWritten(f"{target} exists and is left as it is: choose another name, or remove it") from None
    except OSError as error:
        raise PackageNotWritten(
            f"{target} cannot be written: {error.strerror}; choose another folder with --folder"
        ) from None
    return target


def _texts(folder: Traversable, path: Path) -> Iterator[tuple[Path, str]]:
    """The files of the template: their places, and their texts."""
    for entry in folder.iterdir():
        if entry.is_dir():
            yield from _texts(entry, path / entry.name)
        elif not entry.name.endswith(".pyc"):
            yield path / entry.name, entry.read_text(encoding="utf-8")
