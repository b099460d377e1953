"""Generated modules on disk: written once, in a folder named by a hash of their content, and imported from there."""

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
Result = TypeVar("Result")
LOG = logging.getLogger("labbook")
_making = threading.RLock()


def cache_folder(backend: str) -> Path:
    """Folder of a backend's generated modules: $LABBOOK_CACHE, or labbook/<backend> in the user's cache folder."""
    home = os.environ.get("LABBOOK_CACHE")
    if home:
        return Path(home)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "labbook" / backend


def digest(*parts: str) -> str:
    """Hash of all texts that decide the compiled code of a module."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:24]


def alone(make: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Decorate `make` with a lock that all backends share.

    Generating or importing a module parses Python, and before 3.11.8 its parser fails at times in two threads at once
    (SystemError: AST constructor recursion depth mismatch).
    """

    @wraps(make)
    def locked(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with _making:
            return make(*args, **kwargs)

    return locked


def load(name: str, text: str, folder: Path) -> ModuleType:
    """Import module `name` with the source `text`, written to `folder`, where compilers look for it.

    `text` is executed, whatever the disk has: a file with other content is damaged, as after a power failure, and is
    written again. A module is imported once, even if two callers miss it in their caches: a second import would
    register its kernels with the compiler again, in place of those that the first caller may be launching.

    Raises:
        OSError: the folder cannot be written; the message names LABBOOK_CACHE.
    """
    path = folder / f"{name}.py"
    loaded = sys.modules.get(name)
    if loaded is not None and loaded.__file__ == str(path):
        return loaded
    try:
        _keep(path, text.encode())
    except OSError as error:
        why = f"{error.strerror} (compiled code is kept there; let LABBOOK_CACHE name another folder)"
        raise OSError(error.errno, why, str(folder)) from error
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    # Before it is executed: Numba and Warp look a module up by its name while its decorators run.
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
    """Write a file of the cache atomically, by a rename: readers see the old or the new content, also after a power
    failure."""
    partial = path.with_name(f"{path.name}.{secrets.token_hex(6)}.part")
    try:
        with open(partial, "xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(partial)
        raise
