"""Numba's compiled code on disk, each file with a checksum: a damaged one is removed and compiled again.

Numba unpickles any content, and would run machine code with a changed bit. Unpickling stops at the end of a pickle, so
a checksum behind it does not disturb Numba.
"""

import hashlib
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from labbook_dem import generated
from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile

_LENGTH = 16  # bytes of a checksum


def cached(**options: Any) -> Callable[[Callable], Any]:
    """Return a decorator `numba.njit` with these options, whose compiled code is cached beside the function's
    module."""

    def compiled(function: Callable) -> Any:
        dispatcher: Any = njit(**options)(function)
        dispatcher._cache = _Cache(function)
        return dispatcher

    return compiled


class _Cache(FunctionCache):
    def __init__(self, function: Callable):
        super().__init__(function)
        implementation: Any = self._impl
        self._cache_file = _Files(
            self._cache_path, implementation.filename_base, implementation.locator.get_source_stamp()
        )


class _Files(IndexDataCacheFile):
    """Index and code of the kernels of one function."""

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        # Collected in memory: code and checksum reach the disk by one rename, so that other processes see both or none.
        content = io.BytesIO()
        yield content
        generated.write(Path(filepath), content.getvalue() + _checksum(content.getvalue()))

    def _load_index(self) -> dict:
        return super()._load_index() if _is_intact(self._index_path) else {}

    def _load_data(self, name: str) -> Any:
        return super()._load_data(name) if _is_intact(self._data_path(name)) else None


def _checksum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_LENGTH).digest()


def _is_intact(path: str) -> bool:
    """Return True if a file has the checksum of its content or does not exist; remove it otherwise."""
    try:
        content = Path(path).read_bytes()
    except FileNotFoundError:
        return True
    if len(content) > _LENGTH and _checksum(content[:-_LENGTH]) == content[-_LENGTH:]:
        return True
    generated.LOG.warning("%s: compiled code is damaged: it is compiled again", path)
    with suppress(FileNotFoundError):  # another process may have removed it as well
        os.unlink(path)
    return False
