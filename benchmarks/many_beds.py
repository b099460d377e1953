"""Many small beds: wall time of a whole study against that of its beats, for one outlet and thousands of seeds.

The bed is that of `labbook new`, a wedge hopper in mixed precision, with as many grains and seeds as asked. Each study
runs in a process and a lab of its own, once before with few seeds, so that kernels are cached. On a GPU all beds are
stepped in one ensemble, and what beats take is their wall time; on a CPU it is the processor time of all steps, divided
by the cores.

    python benchmarks/many_beds.py --backend warp --device cuda:0 --beds 128 1024 10000 --out many.json
    python benchmarks/many_beds.py --grains 200 --beds 200
    python benchmarks/many_beds.py --backend warp --device cuda:0 --grains 2000 --beds 128 --fill dense --fed 2

`--trace FOLDER` writes a line a turn of an ensemble to a file for each study: what waited for what.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from labbook.backend.machine import cores, hardware
from labbook.lab.packings import PackingRecord
from labbook.lab.records import RunRecord

STUDY = """
name: many-beds
about: {beds} beds of {grains} spheres, one outlet
grains: {{shape: sphere, diameter: 4 mm, density: 2500 kg/m^3, count: {grains}}}
contact: {{law: hertz-mindlin, shear_modulus: 2 MPa, poisson_ratio: 0.25, friction: 0.5, restitution: 0.6}}
container: {{kind: wedge-hopper, width: {width:g} mm, thickness: 12 mm, height: {height:g} mm, angle: 60 deg,
  orifice: 24 mm}}
{fill}
replicates: {beds}
{ending}
numerics: {{precision: {precision}{beat}}}
measure: [flow_rate]
"""
WIDTH = 0.06  # m
RUN = """
import json, logging, sys, time
begun = time.perf_counter()
from pathlib import Path
from labbook.backend import load as backend
from labbook.lab import LabFolder
from labbook.run.runner import Runner
from labbook.study import load
imported = time.perf_counter() - begun
study, lab, name, device, trace = sys.argv[1:]
if trace:
    turns = logging.getLogger("labbook.turns")
    turns.setLevel(logging.DEBUG)
    turns.addHandler(logging.FileHandler(trace, "w"))
    turns.debug("imports: %.3f s", imported)
done = Runner(load(Path(study)), LabFolder(Path(lab)), backend(name), device).run()
assert done.complete, done.failed[:3]
print(json.dumps({"stepping": done.stepping, "work": done.work_done, "preparing": done.preparing, "imports": imported}))
"""


UNFED = "window: {start: 0.15, end: 0.6}"
FED = "feed: {{kind: reinject}}\nrestart: {{kind: break}}\nstop: {{max_time: {time} s}}"


def study(beds: int, args: argparse.Namespace) -> str:
    """The study as YAML; its hopper is wider where there are more grains."""
    grains, fill = args.grains, args.fill
    width = WIDTH * max(1.0, (grains / 1000) ** 0.5)
    stated = f"fill: {{kind: {fill}}}" if fill else ""
    sizes = {"width": 1e3 * width, "height": 8e3 * width}
    ending = FED.format(time=args.fed) if args.fed else UNFED
    beat = f", steps_per_beat: {args.steps_per_beat}" if args.steps_per_beat else ""
    return STUDY.format(
        beds=beds, grains=grains, precision=args.precision, fill=stated, ending=ending, beat=beat, **sizes
    )


def measured(folder: Path, beds: int, args: argparse.Namespace) -> dict[str, Any]:
    """Times of one study, and the files that it leaves."""
    file, lab = folder / f"many-{beds}.yaml", folder / f"lab-{beds}"
    file.write_text(study(beds, args), encoding="utf-8")
    trace = args.trace / f"turns-{beds}.txt" if args.trace else ""
    command = [sys.executable, "-c", RUN, str(file), str(lab), args.backend, args.device, str(trace)]
    begun = time.perf_counter()
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    wall = time.perf_counter() - begun
    if ended.returncode:
        raise SystemExit(ended.stderr)
    inside = json.loads(ended.stdout.splitlines()[-1])
    records: list[RunRecord | PackingRecord] = [RunRecord.read(path) for path in (lab / "runs").iterdir()]
    packings = [PackingRecord.read(path) for path in (lab / "packings").iterdir()]
    process = sum(record.process_time for record in (*records, *packings))
    beats = process / cores() if args.device == "cpu" else inside["stepping"]
    files = [entry for root, _, names in os.walk(lab) for entry in (Path(root) / name for name in names)]
    fillings = sum(session.grain_steps for record in packings for session in record.sessions)
    return {
        "beds": beds,
        "wall": wall,
        "beats": beats,
        "ratio": wall / beats,
        "milliseconds_a_run": 1e3 * wall / beds,
        "grain_steps": inside["work"],
        "fillings": fillings / inside["work"],
        "rate": inside["work"] / wall,
        "imports": inside["imports"],
        "preparing": inside["preparing"],
        "files": len(files),
        "bytes": sum(path.stat().st_size for path in files),
    }


def main() -> None:
    """Run the studies, print a row of each, and write all to a file if one is named."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--backend", default="numba")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--beds", type=int, nargs="+", default=[200])
    parser.add_argument("--grains", type=int, default=1000)
    parser.add_argument("--precision", default="mixed")
    parser.add_argument("--fill", default="", help="kind of the filling, if not the usual one")
    parser.add_argument("--fed", type=float, default=0.0, help="feed the beds for this time [s]; 0: let them run empty")
    parser.add_argument("--steps-per-beat", type=int, default=0, help="steps of a beat, if not the usual number")
    parser.add_argument("--folder", type=Path, help="folder for the labs; default: a temporary one")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--trace", type=Path, help="folder for a line a turn")
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(dir=args.folder) as temporary:
        folder = Path(temporary)
        measured(folder, 4, args)  # kernels are compiled
        for beds in args.beds:
            row = measured(folder, beds, args)
            rows.append(row)
            print(
                f"{row['beds']:6} beds {row['wall']:7.1f} s, beats {row['beats']:7.1f} s: {row['ratio']:.2f}; "
                f"{row['milliseconds_a_run']:.1f} ms a run, {row['rate']:.3g} grain-steps/s, fillings "
                f"{row['fillings']:.0%}; {row['files']} files, {row['bytes'] / 1e6:.0f} MB",
                flush=True,
            )
            if args.out:
                about = {"what": "many small beds", "measured": datetime.now(UTC).strftime("%Y-%m-%d")}
                about |= {"hardware": hardware(), "backend": args.backend, "device": args.device}
                about |= {"grains": args.grains, "precision": args.precision, "fill": args.fill or "usual"}
                about |= {"fed": args.fed, "steps_per_beat": args.steps_per_beat or "usual"}
                args.out.write_text(json.dumps(about | {"rows": rows}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
