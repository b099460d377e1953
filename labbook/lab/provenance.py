"""Where numbers come from: commit, versions, processor, device."""

import os
import platform
import subprocess
from collections.abc import Iterable
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

from labbook.backend.machine import cores, gpu, processor, versions
from labbook.plugins import Extension

PACKAGE = Path(__file__).parents[1]
"""The folder that labbook is imported from."""
PACKAGES = ("labbook", "numpy", "scipy", "numba", "llvmlite", "warp-lang", "pydantic")
"""Packages whose versions can change a number, beside those of extensions."""


def now() -> str:
    """The time in UTC, ISO 8601, with milliseconds: runs of small beds end several a second."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def provenance(device: str, used: Iterable[Extension] = ()) -> dict[str, Any]:
    """Origin of a session's numbers: commit, versions, processor, device; and the extensions that were `used`, by
    package and version. `machine` names processor and device: speeds are forecast from runs on the same."""
    origin, used = _of_machine(device), tuple(used)
    if not used:
        return origin
    packages = {one.package: one.version for one in used}
    return {**origin, "packages": origin["packages"] | packages, "extensions": {one.use: one.made_by for one in used}}


@lru_cache(maxsize=8)
def _of_machine(device: str) -> dict[str, Any]:
    card = None if device == "cpu" else gpu()
    machine = f"{processor()}, {os.cpu_count()} cores" + (f", {card[0]}" if card else "")
    return {
        **_commit(PACKAGE),
        "packages": {name: found for name, found in versions(PACKAGES).items() if found},
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
        "processor": processor(),
        "threads": cores(),
        "machine": machine,
        **({"gpu": dict(zip(("name", "driver"), card, strict=True))} if card else {}),
    }


def _commit(package: Path) -> dict[str, Any]:
    """Commit of the checkout that `package` is imported from, and whether it was changed; none if it is
    installed."""
    if _git(package, "ls-files", "--error-unmatch", "__init__.py") is None:
        return {"commit": None, "dirty": None}
    changes = _git(package, "status", "--porcelain", "--", ":/")
    return {"commit": _git(package, "rev-parse", "HEAD"), "dirty": bool(changes)}


def _git(folder: Path, *words: str) -> str | None:
    try:
        done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, timeout=20)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None
