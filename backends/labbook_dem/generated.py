"""Generated modules on disk: written once under a name that says what they are made of, and imported from there."""

import hashlib
import importlib.util
import logging
import os
import secrets
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Made = TypeVar("Made")
LOG = logging.getLogger("labbook")
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
    """Import module `name`, whose source is `text`; it is kept in `folder`, where compilers look for it.

    What is executed is `text`, whatever is on the disk: a file there that has another content is damaged, as after a
    power failure, and is written again. A module is imported once, also where two callers have missed it in a cache of
    theirs: importing it again would register its kernels with the compiler a second time, in place of those that the
    first caller may be launching.
    """
    path = folder / f"{name}.py"
    known = sys.modules.get(name)
    if known is not None and known.__file__ == str(path):
        return known
    try:
        _keep(path, text.encode())
    except OSError as error:
        why = f"{error.strerror} (compiled code is kept there; let LABBOOK_CACHE name another folder)"
        raise OSError(error.errno, why, str(folder)) from error
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        exec(compile(text, str(path), "exec", dont_inherit=True), vars(module))
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _keep(path: Path, content: bytes) -> None:
    try:
        if path.read_bytes() == content:
            return
        LOG.warning("%s: generated source is damaged: it is written again", path)
    except FileNotFoundError:
        path.parent.mkdir(parents=True, exist_ok=True)
    write(path, content)


def write(path: Path, content: bytes) -> None:
    """Write a file of the cache by a rename: readers, also after a power failure, see the old content or the new."""
    part = path.with_name(f"{path.name}.{secrets.token_hex(6)}.part")
    try:
        with open(part, "xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(part)
        raise
