"""The web app on a large lab, and what it costs a study that runs beside it.

`pages`: server time of pages of a lab with 100 000 runs, the first time they are asked for and later. The runs are made
up: rows of the index, with flow rates by Beverloo's law and scatter, of studies with 400 points each.

`polling`: the speed of a study while a browser's page asks for its progress every two seconds, over that without;
rounds alternate between the two. A page that is shown anew after each run is asked for every five seconds besides.

    python benchmarks/web.py pages --out pages.json
    python benchmarks/web.py polling --out polling.json
"""

import argparse
import json
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import labbook
from labbook.backend import load
from labbook.backend.machine import hardware
from labbook.lab import studies
from labbook.lab.database import connect, measurements, runs, transaction, upsert
from labbook.lab.folder import LabFolder
from labbook.lab.index import Index
from labbook.lab.records import Coverage
from labbook.measure import MEASURES, scales
from labbook.plan.demand import Demand, demands
from labbook.run.runner import Runner
from labbook.study import Study

PAGES = (
    "/",
    "/?q=made-up-01",
    "/study/{study}",
    "/study/{study}/point/7",
    "/progress/{study}",
    "/runs",
    "/runs?outcome=clogged",
    "/runs?q=friction+0.1",
    "/runs?study={study}&sort=discharged&page=2",
    "/study/{study}.json",
    "/runs.csv?study={study}",
)
_BASE: dict[str, Any] = {
    "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 700},
    "contact": {"law": "hertz-mindlin", "shear_modulus": "5 MPa", "poisson_ratio": 0.25, "friction": 0.5,
                "rolling_friction": 0.01, "restitution": 0.2},
    "container": {"kind": "wedge-hopper", "width": "60 mm", "height": "200 mm", "thickness": "1.01 d",
                  "angle": "90 deg", "orifice": "24 mm"},
}  # fmt: skip
_SIDE = 20  # values of each of the two swept keys
_REPLICATES = 5
_POLL, _AGAIN = 2.0, 5.0  # s between two looks of a page at its progress, and before it is shown anew


def made_up(number: int, side: int = _SIDE) -> Study:
    """The study with this number: side x side points."""
    return labbook.define(
        _BASE,
        name=f"made-up-{number:03d}",
        about="Flow rates by Beverloo's law, with scatter between seeds",
        gravity=f"{9.81 + number / 100:.2f} m/s^2",  # another scene each
        sweep={
            "container.orifice": [f"{D:.4g} mm" for D in np.linspace(15, 40, side)],
            "contact.friction": [round(float(f), 3) for f in np.linspace(0.1, 1, side)],
        },
        replicates=_REPLICATES,
        measure=["flow_rate", "packing"],
        fit=["beverloo", "janda"],
    )


def large_lab(folder: Path, wanted: int, side: int = _SIDE) -> LabFolder:
    """A lab with an index of `wanted` made-up runs or some more; their folders are not there."""
    lab = LabFolder(folder)
    Index(lab).close()
    can, rng = load("numba").capabilities, np.random.default_rng(1)
    engine = connect(lab.catalogue, read_only=False)
    try:
        for number in range(max(2, -(-wanted // (side**2 * _REPLICATES)))):  # pages are of the second
            study = made_up(number, side)
            studies.keep(lab, study.name, study.yaml())
            rows, numbers = [], []
            for demand in demands(study, _REPLICATES):
                keys = demand.keys(can)
                rows.append(_row(study, demand, asdict(keys), can.cache_version))
                numbers += _numbers(study, demand, keys.run, rng)
            with transaction(engine, lab) as connection:
                upsert(connection, runs, rows)
                for at in range(0, len(numbers), 1000):
                    upsert(connection, measurements, numbers[at : at + 1000])
    finally:
        engine.dispose()
    return lab


def _row(study: Study, demand: Demand, keys: dict[str, str], version: int) -> dict[str, Any]:
    shared = demand.shared
    coverage = Coverage(
        duration=3.0, steps=100_000, grains=700, crossed=460, last_crossing=2.9, stop=shared.stop,
        guards=demand.guards, probes=tuple(sorted(shared.probe_names)),
    )  # fmt: skip
    ended = f"2026-01-{1 + demand.seed:02d}T{demand.point.index // 60 % 24:02d}:{demand.point.index % 60:02d}:00+00:00"
    told = {"outcome": "clogged" if demand.point.index % 97 == 0 else "finished", "finished": ended, "stamp": 0}
    told |= {
        "grains": 700,
        "discharged": 0.66,
        "duration": 3.0,
        "wall_time": 9.0,
        "rate": 7e6,
        "bytes": 300_000,
        "suspect": "",
    }
    known = {"study": study.name, "label": demand.point.label, "seed": demand.seed, "backend": "numba", "device": "cpu"}
    named = {f"{name}_key": key for name, key in keys.items()}
    blank = {column.key: getattr(column.default, "arg", None) for column in runs.columns}
    return {**blank, **told, **known, **named, "cache_version": version, "coverage": coverage.model_dump_json()}


def _numbers(study: Study, demand: Demand, key: str, rng: np.random.Generator) -> Iterator[dict[str, Any]]:
    scene = demand.point.scene
    D, friction = float(getattr(scene.container, "orifice", 0.0)), float(getattr(scene.contact, "friction", 0.0))
    W = 2500 * 0.6 * 3e-3 * scene.gravity**0.5 * (D - 1.9 * 3e-3) ** 1.5 * (1 - 0.2 * friction)
    found = {"flow_rate": (W, "kg/s"), "grain_rate": (W / 3.5e-5, "1/s"), "packing_fraction": (0.6, "")}
    for name, (value, unit) in found.items():
        measure = "packing" if name == "packing_fraction" else "flow_rate"
        yield {
            "run_key": key, "quantity": name, "version": MEASURES[measure].version, "measure": measure,
            "window_start": study.window.start, "window_end": study.window.end,
            "window_timed": study.window.timed, "window_scales": scales.in_text(study.window), "window": "made up",
            "value": value * rng.normal(1, 0.01), "error": 0.01 * value, "n_effective": 30.0, "unit": unit,
            "method": "made up", "note": "",
        }  # fmt: skip


def pages(folder: Path, wanted: int, repeats: int, side: int = _SIDE) -> list[dict[str, Any]]:
    """Server time of every page [ms]: the first time, and the median of `repeats` later ones; and its size [kB]."""
    lab = large_lab(folder, wanted, side)
    found = []
    with served(lab.folder) as address:
        _ask(address + "/card/made-up-000")  # imports what all results need
        for page in PAGES:
            where = address + page.format(study="made-up-001")
            times, size = [], 0
            for _ in range(1 + repeats):
                began = time.perf_counter()
                size = len(_ask(where))
                times.append(1e3 * (time.perf_counter() - began))
            told = {"first": times[0], "later": statistics.median(times[1:]), "kilobytes": size / 1e3}
            found.append({"page": page, **told})
    return found


def polling(folder: Path, rounds: int, replicates: int) -> list[dict[str, Any]]:
    """Wall time [s] of a study on all cores without and with a page that polls, round by round."""
    backend, found = load("numba"), []
    study = labbook.define(
        _BASE, name="polled", sweep={"container.orifice": "[21, 24, 28, 32] mm"}, replicates=replicates,
        fill={"friction": 0.01}, measure=["flow_rate", "packing"], fit=["beverloo", "janda"],
    )  # fmt: skip
    Runner(study.change(replicates=1), LabFolder(folder / "warm"), backend).run()  # compiles
    for number in range(rounds):
        order = (False, True) if number % 2 == 0 else (True, False)
        told: dict[str, Any] = {}
        for polled in order:
            lab = LabFolder(folder / f"round-{number}-{'polled' if polled else 'alone'}")
            with served(lab.folder) if polled else _nothing() as address:
                stop = threading.Event()
                if polled:
                    threading.Thread(target=_poll, args=(address, study.name, stop), daemon=True).start()
                began = time.perf_counter()
                done = Runner(study, lab, backend).run().done
                told["polled" if polled else "alone"] = time.perf_counter() - began
                told["runs"] = done
                stop.set()
        found.append({**told, "ratio": told["polled"] / told["alone"]})
        print(found[-1], flush=True)
    return found


def _poll(address: str, study: str, stop: threading.Event) -> None:
    """What an open page of a study that runs asks for, until it is told to stop."""
    shown = 0.0
    while not stop.is_set():
        page = "progress/" if time.monotonic() - shown < _AGAIN else "study/"
        shown = shown if page == "progress/" else time.monotonic()
        with suppress(OSError):  # at first nothing is there
            _ask(f"{address}/{page}{study}")
        stop.wait(_POLL)


@contextmanager
def _nothing() -> Iterator[str]:
    yield ""


@contextmanager
def served(lab: Path) -> Iterator[str]:
    """The address of the app, in a process of its own as `labbook web` is."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    code = "from labbook.cli import main; main()"
    words = ["web", "--lab", str(lab), "--no-open", "--port", str(port)]
    process = subprocess.Popen([sys.executable, "-c", code, *words], stdout=subprocess.DEVNULL)
    address = f"http://127.0.0.1:{port}"
    try:
        for _ in range(300):
            try:
                _ask(f"{address}/static/icon.svg")
                break
            except OSError:
                time.sleep(0.1)
        yield address
    finally:
        process.terminate()
        process.wait(30)


def _ask(address: str) -> bytes:
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with opener.open(address, timeout=120) as answer:
        return answer.read()


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and write the figures."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("what", choices=("pages", "polling"))
    words.add_argument("--runs", type=int, default=100_000, help="Runs of the large lab.")
    words.add_argument("--repeats", type=int, default=7, help="Later looks at each page; rounds of polling.")
    words.add_argument("--replicates", type=int, default=16, help="Runs of each of four points of the polled study.")
    words.add_argument("--out", type=Path, help="Also write the figures to this JSON file.")
    said = words.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        if said.what == "pages":
            found = pages(Path(folder) / "lab", said.runs, said.repeats)
            for one in found:
                times = f"first {one['first']:8.1f} ms, later {one['later']:7.1f} ms"
                print(f"{one['page']:50} {times}, {one['kilobytes']:.0f} kB")
        else:
            found = polling(Path(folder), said.repeats, said.replicates)
            ratios = [one["ratio"] for one in found]
            print(
                f"with a page that polls over without: median {statistics.median(ratios):.3f} of {len(ratios)} rounds"
            )
    result = {
        "what": said.what,
        "runs": said.runs if said.what == "pages" else None,
        "hardware": hardware(),
        "found": found,
    }
    if said.out:
        said.out.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
