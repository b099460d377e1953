"""A whole campaign on one device of a machine, on two, on four: what each further device gains.

Fan's hopper with inclined bottoms is run from nothing, with a lab of its own for each number of devices, and twice on
the first one: compiled kernels are there the second time, which counts. Ratios are to one device.

    python benchmarks/devices.py --backend warp --device cuda:all --out devices.json
    python benchmarks/devices.py --backend warp --device cuda:0,cuda:1 --count 1 2
"""

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from labbook import Lab
from labbook.backend import load
from labbook.backend.machine import hardware
from labbook.plan.devices import parse_devices
from labbook.study import Study
from labbook.study import load as read

STUDY = Path(__file__).parents[1] / "studies/fan2023-hopper-angle.yaml"


def once(study: Study, backend: str, devices: Sequence[str]) -> dict[str, Any]:
    """Run `study` from nothing on `devices`: seconds, runs, and grain-steps."""
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        done = Lab(folder, backend, ",".join(devices)).run(study)
        seconds = time.perf_counter() - begun
    if not done.done == done.requested:
        raise SystemExit(f"{done}")
    return {"devices": list(devices), "seconds": seconds, "runs": done.done, "grain_steps": done.work_done}


def measure(study: Study, backend: str, devices: Sequence[str], counts: Sequence[int]) -> list[dict[str, Any]]:
    """`once` for each number of devices that there are, with the ratio of its speed to that of one."""
    once(study, backend, devices[:1])  # compiles
    found = [once(study, backend, devices[:count]) for count in counts if count <= len(devices)]
    for one in found:
        one["ratio"] = found[0]["seconds"] / one["seconds"]
        print(f"{len(one['devices'])} devices: {one['seconds']:.1f} s, {one['ratio']:.2f} times as fast", flush=True)
    return found


def main() -> None:
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", default="warp")
    parser.add_argument("--device", default="cuda:all")
    parser.add_argument("--study", type=Path, default=STUDY)
    parser.add_argument("--count", type=int, nargs="+", default=[1, 2, 4], help="numbers of devices, the least first")
    parser.add_argument("--out", type=Path, help="JSON file")
    given = parser.parse_args()
    devices = parse_devices(given.device, load(given.backend))
    found = measure(read(given.study), given.backend, devices, given.count)
    if given.out:
        text = json.dumps({"study": given.study.stem, "hardware": hardware(), "measured": found}, indent=2)
        given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
