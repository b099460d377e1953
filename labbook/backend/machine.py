"""The machine that backends run on: processor, cores, memory, GPU, and the versions of packages."""

import math
import os
import platform
import subprocess
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_NUMBERS = 1 << 17
"""Square roots of one pass of `pace`: so many that threads seldom wait for the interpreter between passes."""
_PASS = 205e-6
"""Processor time [s] of a pass on the reference core, an AMD EPYC (Zen 3). The number of cycles of a square root is
much
the same on all processors, so that passes compare clock rates. Vectors of 512 bits do not change that; speeds that gain
from them have a reference of their own (`labbook.plan.forecast`)."""


@dataclass(frozen=True)
class Pace:
    """Present speed of this machine's cores.

    Args:
        core: Speed of a core over that of the reference core, by processor time.
        share: Part of a core that each thread gets if all of them work.
    """

    core: float
    share: float


@lru_cache(maxsize=8)
def pace(threads: int, seconds: float = 0.5) -> Pace:
    """Measure the speed of cores with a number of threads that work side by side; once in a process.

    Args:
        threads: Number of threads.
        seconds: Duration of the measurement [s].
    """
    import numpy as np

    def work(_: int) -> tuple[int, float, float]:
        numbers = np.linspace(1.0, 2.0, _NUMBERS)
        roots = np.empty_like(numbers)
        passes, began, used = 0, time.perf_counter(), time.thread_time()
        now = began
        while passes == 0 or now < began + seconds:
            np.sqrt(numbers, out=roots)
            passes, now = passes + 1, time.perf_counter()
        return passes, time.thread_time() - used, now - began

    with ThreadPoolExecutor(threads) as pool:
        passes, used, wall = map(sum, zip(*pool.map(work, range(threads)), strict=True))
    return Pace(core=_PASS * passes / used, share=min(1.0, used / wall))


def cores() -> int:
    """Processor cores that this process may use; in a Slurm job those of the job, even if it does not bind them."""
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    of_job = os.environ.get("SLURM_CPUS_ON_NODE", "")
    return max(1, min(here, int(of_job))) if of_job.isdigit() else here


def memory() -> float:
    """Memory of this machine [bytes]; infinite if the system does not report it."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return math.inf


def processor() -> str:
    """Name of the processor."""
    for line in _cpuinfo().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


@lru_cache(maxsize=1)
def wide_vectors() -> bool:
    """True if this processor has vectors of 512 bits, from which the CPU backend gains most."""
    return platform.machine().lower() in ("x86_64", "amd64") and " avx512f" in _cpuinfo()


def _cpuinfo() -> str:
    try:
        return Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def gpu() -> tuple[str, str] | None:
    """Name and driver of the first NVIDIA GPU; None where there is none."""
    query = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    try:
        output = subprocess.run(query, capture_output=True, text=True, timeout=20, check=True).stdout
    except (OSError, subprocess.SubprocessError):
        return None
    name, comma, driver = output.partition("\n")[0].partition(",")
    return (name.strip(), driver.strip()) if comma else None


def versions(packages: Iterable[str]) -> dict[str, str | None]:
    """Installed version of each package; None where it is not installed."""
    return {name: _version(name) for name in packages}


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def hardware() -> dict[str, object]:
    """Machine of a speed measurement: processor, cores, GPU, system, and the versions that affect speed."""
    installed_versions = versions(("numba", "llvmlite", "numpy", "warp-lang"))
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "gpu": ", ".join(device) if (device := gpu()) else None,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {name: number for name, number in installed_versions.items() if number},
    }
