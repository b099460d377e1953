"""Generated modules on disk: written once under a name that says what they are made of, and imported from there."""

import hashlib
import importlib.util
import os
import sys
import tempfile
import threading
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Made = TypeVar("Made")
_making = threading.RLock()


def cache_folder(backend: str) -> Path:
    """Where a backend's generated modules live: in $LABBOOK_CACHE, or labbook/<backend> in the user's cache folder."""
    home = os.environ.get("LABBOOK_CACHE")
    if home:
        return Path(home)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "labbook" / backend


def digest(*parts: str) -> str:
    """Hash of all that decides what a module compiles to."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:24]


def alone(make: Callable[Arguments, Made]) -> Callable[Arguments, Made]:
    """`make`, by one thread at a time, whichever backend it belongs to.

    What generates or imports a module parses Python, and before 3.11.8 its parser fails now and then in two threads at
    once (SystemError: AST constructor recursion depth mismatch).
    """

    @wraps(make)
    def locked(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Made:
        with _making:
            return make(*args, **kwargs)

    return locked


def load(name: str, text: str, folder: Path) -> ModuleType:
    """Import module `name` from `folder`; written there, by a rename, if it is missing.

    A module is imported once, also where two callers have missed it in a cache of theirs: importing it again would
    register its kernels with the compiler a second time, in place of those that the first caller may be launching.
    """
    path = folder / f"{name}.py"
    known = sys.modules.get(name)
    if known is not None and known.__file__ == str(path):
        return known
    if not path.exists():
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile("w", dir=folder, suffix=".part", delete=False, encoding="utf-8") as file:
                file.write(text)
            os.replace(file.name, path)
        except OSError as error:
            why = f"{error.strerror} (compiled code is kept there; let LABBOOK_CACHE name another folder)"
            raise OSError(error.errno, why, str(folder)) from error
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
