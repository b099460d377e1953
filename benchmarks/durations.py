"""CPU time of the tests: the slowest, and the sum of each folder against its budget.

    python benchmarks/durations.py [PYTEST_ARGUMENTS]     default: -m "not ring and not browser", as `make test`

Compiled kernels start from an empty cache, as in CI. CPU time (of a test, its fixtures and its child processes) is
measured instead of wall time, since a busy machine does not change it. The result is written to
benchmarks/results/DATE-test-durations.txt; the exit status is 1 if a folder is over its budget. Two cores share the
tests: `make test` takes at least half of the sum, and has to stay below 20 minutes.
"""

import json
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = "LABBOOK_TEST_DURATIONS"
"""Environment variable: where each process of pytest writes what it measured."""
SLOWEST = 30
BUDGETS = {
    "tests/contract": 480,
    "tests/stress": 250,
    "tests/verification": 350,
    "tests/web": 200,
    "tests/unit/api": 60,
    "tests/unit/backend": 60,
    "tests/unit/checks": 150,
    "tests/unit/dem": 100,
    "tests/unit/docs": 60,
    "tests/unit/numba": 100,
    "tests/unit/report": 80,
    "tests/unit/run": 150,
    "tests/unit/warp": 60,
}
"""CPU time that the tests of a folder may take [s]; with `OTHER` for each further folder, 2180 s in all."""
OTHER = 10


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Write the CPU time of a test as it ends (this module is a plugin of pytest)."""
    begun = _cpu_time()
    result = yield
    line = json.dumps({"test": item.nodeid, "cpu": round(_cpu_time() - begun, 2)})
    with (Path(os.environ[FOLDER]) / f"{os.getpid()}.jsonl").open("a", encoding="utf-8") as stream:
        stream.write(line + "\n")
    return result


def _cpu_time() -> float:
    """CPU time of this process and of its children that have ended [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def folder_of(test: str) -> str:
    """Folder of a test, by which budgets go: one below `tests`, or one below `tests/unit`."""
    parts = test.partition("::")[0].split("/")[:-1]
    return "/".join(parts[: 3 if parts[1:2] == ["unit"] else 2])


def report(times: Iterable[tuple[str, float]]) -> tuple[str, list[str]]:
    """The table of folders and slowest tests, and the folders over their budgets.

    Args:
        times: name of each test, and its CPU time [s].
    """
    times = sorted(times, key=lambda pair: -pair[1])
    sums: defaultdict[str, float] = defaultdict(float)
    for test, seconds in times:
        sums[folder_of(test)] += seconds
    lines = [f"{len(times)} tests, {sum(sums.values()):.0f} s of CPU time", "", "CPU time  budget  folder"]
    lines += [f"{sums[name]:6.0f} s  {BUDGETS.get(name, OTHER):4} s  {name}" for name in sorted(sums)]
    lines += ["", f"slowest {min(SLOWEST, len(times))} tests"]
    lines += [f"{seconds:6.1f} s  {test}" for test, seconds in times[:SLOWEST]]
    return "\n".join(lines) + "\n", [name for name in sorted(sums) if sums[name] > BUDGETS.get(name, OTHER)]


def measure(arguments: list[str]) -> list[tuple[str, float]]:
    """Run the tests with an empty cache of kernels; the CPU time of each [s], by its name."""
    with TemporaryDirectory() as folder, TemporaryDirectory() as cache:
        paths = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
        caches = {"LABBOOK_CACHE": cache, "WARP_CACHE_PATH": f"{cache}/warp"}
        environment = {**os.environ, FOLDER: folder, **caches, "PYTHONPATH": paths}
        subprocess.run([sys.executable, "-m", "pytest", "-p", "durations", *arguments], cwd=ROOT, env=environment)
        lines = [line for path in Path(folder).iterdir() for line in path.read_text(encoding="utf-8").splitlines()]
    return [(entry["test"], entry["cpu"]) for entry in map(json.loads, lines)]


def main(arguments: list[str]) -> int:
    """Measure, write the file and say which folders are over their budgets."""
    arguments = arguments or ["-q", "-n", "auto", "-m", "not ring and not browser"]
    text, over = report(measure(arguments))
    path = ROOT / f"benchmarks/results/{date.today()}-test-durations.txt"
    path.write_text(f"python benchmarks/durations.py {' '.join(arguments)}\n{text}", encoding="utf-8")
    print(text)
    for name in over:
        print(f"over its budget: {name}")
    return bool(over)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
