"""The study that `labbook new` writes."""

from importlib.resources import files
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from labbook.study.schema import Name


class NotWritten(Exception):
    """The study was not written; the message says why and what to do."""


def write(name: str, folder: Path) -> Path:
    """Write a commented study called `name` to `folder`/`name`.yaml; an existing file is left alone.

    Raises NotWritten for a name that a study cannot have, a file that exists and a folder that cannot be written to.
    """
    try:
        TypeAdapter(Name).validate_python(name)
    except ValidationError:
        raise NotWritten(f"{name!r} cannot be a study's name: use letters, digits, - and _, a letter first") from None
    path = folder / f"{name}.yaml"
    text = files("labbook.study").joinpath("template.yaml").read_text(encoding="utf-8")
    text = text.replace("name: template\n", f"name: {name}\n").replace(" FILE ", f" {path} ")
    try:
        with open(path, "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise NotWritten(f"{path} exists and is left as it is: choose another name, or remove it") from None
    except OSError as error:
        raise NotWritten(f"{path} cannot be written: {error.strerror}; choose another folder with --folder") from None
    return path
