"""What a step of the engines that ship costs, as measured: forecasts rest on it where a lab has no runs of its own."""

import platform
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

DEFAULT_SPEED = 5e6
"""Grain-steps per second and lane that are assumed of an engine that nothing is known of."""
CACHED = 50_000
"""Grains beyond which a scene is larger than a processor's caches."""
_BEYOND = 1.9
"""How much dearer a grain-step is there (docs/engine.md: 26.5 and 13.7 million a second)."""


@dataclass(frozen=True)
class Rate:
    """Cost of one step of a lane: `step` [s] however few grains there are, and `grain` [s] for every grain; `compiling`
    [s]: before the first step of a set of features, unless its code is cached. `source`: where that was measured.
    `beat`: what each probe of a member costs the host at each beat [s], while the device waits."""

    step: float
    grain: float
    compiling: float
    source: str
    beat: float = 0.0

    def of(self, grains: float) -> float:
        """Cost of a grain-step [s] in a scene of so many grains."""
        return self.grain * (beyond_caches(grains) if self.step == 0 else 1.0)


def beyond_caches(grains: float) -> float:
    """How many times dearer a grain-step is on a processor in a scene of so many grains than in a small one."""
    return _BEYOND if grains > CACHED else 1.0


_ZEN4 = "one core of an AMD EPYC with AVX-512"
_ZEN3 = "one core of an AMD EPYC without AVX-512"
_H200 = "an NVIDIA H200"
_HOST = 1.5e-3  # 1 ms a beat with one probe (beside an H200) to 6 ms with three (beside an H100): docs/gpu-engine.md
MEASURED = {
    ("numba", "cpu", "sphere", "double", True): Rate(0, 1 / 24e6, 9, _ZEN4),
    ("numba", "cpu", "sphere", "mixed", True): Rate(0, 1 / 31e6, 9, _ZEN4),
    ("numba", "cpu", "spherocylinder", "double", True): Rate(0, 1 / 8.2e6, 18, _ZEN4),
    ("numba", "cpu", "spherocylinder", "mixed", True): Rate(0, 1 / 8.3e6, 18, _ZEN4),
    ("numba", "cpu", "sphere", "double", False): Rate(0, 1 / 8.7e6, 20, _ZEN3),
    ("numba", "cpu", "sphere", "mixed", False): Rate(0, 1 / 9.8e6, 20, _ZEN3),
    ("numba", "cpu", "spherocylinder", "double", False): Rate(0, 1 / 3.5e6, 40, _ZEN3),
    ("numba", "cpu", "spherocylinder", "mixed", False): Rate(0, 1 / 3.5e6, 40, _ZEN3),
    ("warp", "cuda", "sphere", "mixed", None): Rate(5.0e-6, 1.35e-10, 4, _H200, _HOST),
    ("warp", "cuda", "sphere", "double", None): Rate(5.0e-6, 2.7e-10, 4, _H200, _HOST),
    ("warp", "cuda", "spherocylinder", "mixed", None): Rate(1.0e-5, 3.0e-10, 8, _H200, _HOST),
    ("warp", "cuda", "spherocylinder", "double", None): Rate(1.0e-5, 5.9e-10, 8, _H200, _HOST),
}
"""By engine, kind of device, shape, precision and, of processors, whether they have vectors of 512 bits. From
benchmarks/results, docs/engine.md and docs/gpu-engine.md."""


def rate_of(engine: str, device: str, shape: str, precision: str) -> Rate:
    """The measured cost of a step on `device` (`cpu`, `cuda:0`); DEFAULT_SPEED where nothing was measured."""
    kind = device.partition(":")[0]
    wide = wide_vectors() if kind == "cpu" else None
    return MEASURED.get((engine, kind, shape, precision, wide)) or Rate(0, 1 / DEFAULT_SPEED, 0, "")


@lru_cache(maxsize=1)
def wide_vectors() -> bool:
    """Whether this processor computes with vectors of 512 bits, which the CPU engine gains most from."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return False
    try:
        return " avx512f" in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
