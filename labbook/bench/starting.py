"""How long a fresh process takes to a backend's first step, and what of it is compiling."""

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass

from labbook.backend import load
from labbook.bench.scenes import FAN_STEP, fan
from labbook.filling.placing import place


@dataclass(frozen=True)
class Starting:
    """Times [s] of a fresh process: its first step, kernels cached, and what opening and that step take of it.

    `compiled`: the latter when the kernels had to be compiled.
    """

    first_step: float
    cached: float
    compiled: float


def starting(name: str, repeats: int = 3) -> Starting:
    """Measure the backend `name` in a cache of its own: compiled once, then the best of `repeats`."""
    code = f"from labbook.bench.starting import first_step; first_step({name!r})"
    with tempfile.TemporaryDirectory() as folder:
        runs = []
        for _ in range(1 + repeats):
            began = time.perf_counter()
            done = subprocess.run(
                [sys.executable, "-c", code],
                check=True,
                capture_output=True,
                text=True,
                env={**os.environ, "LABBOOK_CACHE": folder},
            )
            runs.append((time.perf_counter() - began, json.loads(done.stdout)))
    return Starting(min(whole for whole, _ in runs[1:]), min(step for _, step in runs[1:]), runs[0][1])


def first_step(name: str) -> None:
    """Take one step of Fan's settling hopper; print how long opening the backend and that step took [s]."""
    closed, step = fan().close(), FAN_STEP.model_copy(update={"steps_per_beat": 1})
    backend = load(name)
    start = place(closed, "gas", 1)
    began = time.perf_counter()
    ensemble = backend.open(backend.specialise(closed, step), 1)
    ensemble.admit(closed, step, start)
    ensemble.advance(1)
    print(json.dumps(time.perf_counter() - began))
    ensemble.close()
