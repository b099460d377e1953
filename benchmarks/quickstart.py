"""What the quick start concludes on other processors: its verdicts for five other sets of seeds of the bed.

Another processor computes other last digits, which a flowing bed turns into other beds: another set of seeds. The study
is run with several times its replicates, and each set of them is evaluated by itself, as its first page shows it.

    python benchmarks/quickstart.py --sets 5 --lab lab-of-quickstarts
    python benchmarks/quickstart.py --study mine.yaml --json
"""

import argparse
import json
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import labbook
from labbook.lab import Catalogue, evaluations
from labbook.lab.folder import LabFolder
from labbook.lab.records import Observe
from labbook.plan.coverage import finished
from labbook.report.result_box import concerns, headline
from labbook.results.find import results_of
from labbook.study import Study

STUDY = Path(__file__).parents[1] / "studies/quickstart.yaml"


def verdicts(study: Study, folder: Path, sets: int, backend: str = "numba") -> list[dict[str, Any]]:
    """Run `study` with `sets` times its replicates; what each set of seeds alone comes to.

    Each verdict has `seeds`, `headline`, `p` of every fitted law by name, `misses` (laws that miss the points by more
    than their errors at 5 %), `notes` of the fits, `attention`, and `seconds` of wall time that its runs took together.
    """
    many = study.change(replicates=sets * study.replicates)
    labbook.Lab(folder, backend).run(many)
    found = []
    with closing(Catalogue(LabFolder(folder))) as catalogue:
        runs = finished(catalogue, many, backend)
        numbers = evaluations.numbers(catalogue, runs, Observe.of(many.measure, many.window))
    for number in range(sets):
        seeds = range(1 + number * study.replicates, 1 + (number + 1) * study.replicates)
        mine = [run for run in runs if run.seed in seeds]
        results = results_of(study, mine, numbers)
        fits = {name: fit for series in results.series for name, fit in series.fits.items()}
        found.append(
            {
                "seeds": [seeds[0], seeds[-1]],
                "headline": headline(results),
                "p": {name: fit.p_value for name, fit in fits.items()},
                "misses": [name for name, fit in fits.items() if fit.p_value < 0.05],
                "notes": [note for fit in fits.values() for note in fit.notes],
                "attention": concerns(results),
                "seconds": sum(run.record.wall_time for run in mine),
            }
        )
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, and print the verdict of every set of seeds."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--study", type=Path, default=STUDY, help="Study file.")
    words.add_argument("--lab", type=Path, default=Path("lab-of-quickstarts"), help="Folder of the runs.")
    words.add_argument("--sets", type=int, default=5, help="Sets of seeds.")
    words.add_argument("--json", action="store_true", help="Print JSON.")
    said = words.parse_args(arguments)
    found = verdicts(labbook.load(said.study), said.lab, said.sets)
    if said.json:
        print(json.dumps(found, indent=2))
        return
    for one in found:
        print(f"seeds {one['seeds'][0]} to {one['seeds'][1]} ({one['seconds']:.0f} s of runs): {one['headline']}")
        for law, p in one["p"].items():
            print(f"  {law}: p = {p:.2g}{', MISSES THE POINTS' if law in one['misses'] else ''}")
        for text in (*one["notes"], *one["attention"]):
            print(f"  {text}")


if __name__ == "__main__":
    main()
