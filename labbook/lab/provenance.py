"""Provenance of numbers: commit, versions, processor, device."""

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
"""Folder from which labbook is imported."""
PACKAGES = ("labbook", "numpy", "scipy", "numba", "llvmlite", "warp-lang", "pydantic")
"""Packages whose versions can change a number, in addition to extensions."""


def now() -> str:
    """Return the time in UTC, ISO 8601, with milliseconds: runs of small beds end several a second."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def provenance(device: str, extensions: Iterable[Extension] = ()) -> dict[str, Any]:
    """Collect the provenance of a session: commit, versions, processor, device and extensions.

    `machine` names processor and device: run times are forecast from runs on the same machine.

    Args:
        device: `cpu` or the name of a GPU device.
        extensions: Extensions that the runs use.
    """
    origin, extensions = _of_machine(device), tuple(extensions)
    if not extensions:
        return origin
    packages = {extension.package: extension.version for extension in extensions}
    return {
        **origin,
        "packages": origin["packages"] | packages,
        "extensions": {extension.use: extension.made_by for extension in extensions},
    }


@lru_cache(maxsize=8)
def _of_machine(device: str) -> dict[str, Any]:
    card = None if device == "cpu" else gpu()
    machine = f"{processor()}, {os.cpu_count()} cores" + (f", {card[0]}" if card else "")
    return {
        **_commit(PACKAGE),
        "packages": {name: version for name, version in versions(PACKAGES).items() if version},
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
        "processor": processor(),
        "threads": cores(),
        "machine": machine,
        **({"gpu": dict(zip(("name", "driver"), card, strict=True))} if card else {}),
    }


def _commit(package: Path) -> dict[str, Any]:
    """Commit of the checkout from which `package` is imported, and whether it has changes; None if it is installed."""
    # An installed package may lie within the repository of another project, whose commit says nothing about labbook:
    # only a file that git tracks shows a checkout.
    if _git(package, "ls-files", "--error-unmatch", "__init__.py") is None:
        return {"commit": None, "dirty": None}
    changes = _git(package, "status", "--porcelain", "--", ":/")  # of the whole repository: backends are beside it
    return {"commit": _git(package, "rev-parse", "HEAD"), "dirty": bool(changes)}


def _git(folder: Path, *words: str) -> str | None:
    try:
        process = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, timeout=20)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return process.stdout.strip() if process.returncode == 0 else None
