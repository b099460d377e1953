"""Speed of labbook, LIGGGHTS and LAMMPS on the same beds, in one run: Fan's hopper settled, and flowing.

    python benchmarks/peers/speed.py --out speed.json          # about five minutes

Needs Debian's packages liggghts and lammps; one that is missing is left out. Rates are grain-steps per second of
processor time of one thread. All codes take turns, so that what else the machine does is alike for all; a ratio is the
median of those of single rounds. LIGGGHTS has all that labbook has (Hertz-Mindlin, friction, rolling resistance),
LAMMPS no rolling resistance. Starting, reading the bed and the first list are subtracted by a run of no steps.
"""

import argparse
import json
import resource
import shutil
import statistics
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from decks import deck, law_of
from silo import PROGRAMS

from labbook.backend import Backend, load
from labbook.backend.machine import hardware
from labbook.checks.bench.speed import (
    FAN_STEP,
    OUTFLOW,
    SETTLED,
    advance_until,
    fan,
    on_one_thread,
    settle,
    time_member,
)
from labbook.filling.opening import start_of_discharge
from labbook.scene import Scene
from labbook.scene.packing import Packing

STEPS = 4000  # of theirs: some seconds


@dataclass(frozen=True)
class Bed:
    """Grains, and the container in which they rest or flow."""

    name: str
    scene: Scene
    packing: Packing


def beds(backend: Backend, grains: int) -> list[Bed]:
    """The hopper with its bed at rest, and the same after a while of discharge."""
    scene = fan(grains)
    closed = scene.close()
    packing = settle(backend, closed, FAN_STEP, SETTLED)
    flowing = advance_until(
        backend, "cpu", scene, FAN_STEP, start_of_discharge(packing, closed, scene), outflow=OUTFLOW
    )
    return [Bed("settled", closed, packing), Bed("flowing", scene, flowing)]


def theirs(code: str, bed: Bed) -> float:
    """Million grain-steps per second of processor time of another code."""
    own = bed.scene.contact.model_copy(update={"rolling_friction": 0.0}) if code == "lammps" else bed.scene.contact
    scene = bed.scene.model_copy(update={"contact": law_of(code, own)})
    text, files = deck(code, scene, bed.packing, FAN_STEP.dt)
    end = "thermo_modify lost ignore\n"
    spent = []
    for steps in (0, STEPS):
        with tempfile.TemporaryDirectory() as folder:
            here = Path(folder)
            files["in.speed"] = f"{text}{end}run {steps}\n"
            for name, content in files.items():
                (here / name).write_text(content)
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            command = [PROGRAMS[code], "-in", "in.speed", "-log", "none"]
            told = subprocess.run(command, cwd=here, capture_output=True, text=True, errors="replace", timeout=600)
            if told.returncode:
                raise SystemExit(f"{command[0]}: {(told.stdout + told.stderr)[-800:]}")
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return STEPS * len(bed.packing) / (spent[1] - spent[0]) / 1e6


def ours(backend: Backend, precision: str, bed: Bed) -> float:
    """The same of labbook."""
    numerics = FAN_STEP.model_copy(update={"precision": precision})
    return time_member(backend, bed.name, bed.scene, numerics, bed.packing, 1).median


def spread(values: Sequence[float]) -> dict[str, float]:
    """Median and range."""
    return {"median": statistics.median(values), "low": min(values), "high": max(values)}


def worded(found: dict[str, float], form: str) -> str:
    """A median with its range, for print."""
    return f"{found['median']:{form}} ({found['low']:{form}} to {found['high']:{form}})"


def main() -> None:
    """Take turns, print, write."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--grains", type=int, default=3000)
    words.add_argument("--rounds", type=int, default=5)
    words.add_argument("--out", type=Path)
    said = words.parse_args()
    backend = on_one_thread(load("numba"))
    assert backend is not None
    codes = [code for code, program in PROGRAMS.items() if shutil.which(program)]
    print(f"settling {said.grains} grains", flush=True)
    found = []
    for bed in beds(backend, said.grains):
        rates: dict[str, list[float]] = {}
        for turn in range(said.rounds):
            print(f"{bed.name}, round {turn + 1} of {said.rounds}", flush=True)
            for precision in ("double", "mixed"):
                rates.setdefault(f"labbook {precision}", []).append(ours(backend, precision, bed))
            for code in codes:
                rates.setdefault(code, []).append(theirs(code, bed))
        for name, each in rates.items():
            ratios = {
                code: spread([one / other for one, other in zip(each, rates[code], strict=True)])
                for code in codes
                if name not in codes
            }
            found.append({"bed": bed.name, "code": name, "rate": spread(each), "times": ratios})
            over = "; ".join(f"{worded(ratio, '.2f')} times {code}" for code, ratio in ratios.items())
            print(f"  {name}: {worded(spread(each), '.1f')} M/s; {over}".removesuffix("; "), flush=True)
    told = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "hardware": hardware(), "grains": said.grains, "rates": found}
    if said.out:
        said.out.write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()
