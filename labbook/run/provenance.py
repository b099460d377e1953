"""Where numbers come from: commit, versions, processor, device."""

import math
import os
import platform
import subprocess
from datetime import UTC, datetime
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import labbook

PACKAGES = ("labbook", "numpy", "scipy", "numba", "llvmlite", "warp-lang", "pydantic")
"""Packages whose versions can change a number."""


def now() -> str:
    """The time in UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def memory() -> float:
    """Memory of this machine [bytes]; infinite where the system does not tell."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return math.inf


@lru_cache(maxsize=8)
def provenance(device: str) -> dict[str, Any]:
    """What made a session's numbers. `machine` names processor and device: speeds are forecast from runs on
    the same."""
    processor = _processor()
    gpu = None if device == "cpu" else _gpu()
    machine = f"{processor}, {os.cpu_count()} cores" + (f", {gpu['name']}" if gpu else "")
    return {
        **_commit(Path(labbook.__file__).parent),
        "packages": {name: found for name in PACKAGES if (found := _version(name))},
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
        "processor": processor,
        "threads": cores(),
        "machine": machine,
        **({"gpu": gpu} if gpu else {}),
    }


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


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


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _gpu() -> dict[str, str] | None:
    query = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    try:
        done = subprocess.run(query, capture_output=True, text=True, timeout=20)
    except (OSError, subprocess.TimeoutExpired):
        return None
    if done.returncode != 0 or not done.stdout.strip():
        return None
    name, driver = (word.strip() for word in done.stdout.splitlines()[0].split(",", 1))
    return {"name": name, "driver": driver}
