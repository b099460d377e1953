"""What a cluster costs beside the physics: a study of a thousand beds on many Dask workers.

The backend has next to no arithmetic.

Measured: wall time a run on one process, and on the cluster; the largest memory of the process that coordinates; and
the time that importing all runs takes. With more workers than cores the workers wait for one another: the overhead a
run, not the speed, is what this tells.

    python benchmarks/cluster.py --workers 16 --beds 1000 --out cluster.json
"""

import argparse
import json
import os
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from labbook import Lab, define
from labbook.backend.machine import hardware
from labbook.lab import LabFolder
from labbook.lab.index import Index
from labbook.lab.merge import merge
from labbook.study import Study

TOY = Path(__file__).parents[1] / "tests/toy"


def study(beds: int) -> Study:
    """A small bed that every seed fills anew: as many packings as runs."""
    return define(
        {
            "name": "many-beds",
            "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 200},
            "contact": {"law": "hertz-mindlin", "shear_modulus": "2 MPa", "poisson_ratio": 0.25, "friction": 0.5,
                        "restitution": 1.0},
            "container": {"kind": "wedge-hopper", "width": "60 mm", "height": "300 mm", "thickness": "1.01 d",
                          "angle": "90 deg", "orifice": "24 mm"},
            "numerics": {"dt": "10 us", "steps_per_beat": 200},
            "window": {"start": 0.15, "end": 0.6},
            "replicates": beds,
            "measure": ["flow_rate"],
        }
    )  # fmt: skip


def timed(call) -> float:
    """Wall time of a call [s]."""
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


def imported(source: Path, folder: Path) -> None:
    """Import a lab into a new one."""
    index = Index(LabFolder(folder))
    assert not merge(index, source).left_out
    index.close()


def measure(workers: int, beds: int, backend: str) -> dict[str, Any]:
    """All of it."""
    from dask import config  # pyright: ignore[reportMissingImports]
    from distributed import LocalCluster  # pyright: ignore[reportMissingImports]

    # where there are fewer cores than workers these take long to begin
    config.set({"distributed.comm.timeouts.connect": "300s", "distributed.comm.timeouts.tcp": "300s"})
    few = max(1, beds // 10)
    with tempfile.TemporaryDirectory() as place:
        one, many, new = (Path(place) / name for name in ("one", "many", "new"))
        alone = timed(lambda: Lab(one, backend).run(study(few), progress=False))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        local: Any = LocalCluster
        with local(
            n_workers=workers, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
        ) as cluster:
            address = cluster.scheduler_address
            spread = timed(lambda: Lab(many, backend).run(study(beds), progress=False, cluster=address))
        after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        runs = len(list((many / "runs").iterdir()))
        assert runs == beds, f"{runs} of {beds} runs"
        taken = timed(lambda: imported(many, new))
    return {
        "workers": workers,
        "beds": beds,
        "one_process_s_per_run": alone / few,
        "cluster_s_per_run": spread / beds,
        "cluster_s": spread,
        "coordinator_MB_before": before / 1e3,
        "coordinator_MB_largest": after / 1e3,
        "import_s": taken,
        "import_ms_per_run": 1e3 * taken / beds,
    }


def main() -> None:
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workers", type=int, default=16)
    parser.add_argument("--beds", type=int, default=1000)
    parser.add_argument("--backend", default="toy")
    parser.add_argument("--out", type=Path, help="JSON file")
    given = parser.parse_args()
    sys.path.insert(0, str(TOY))
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(TOY), os.environ.get("PYTHONPATH"))))
    found = {"hardware": hardware(), "measured": measure(given.workers, given.beds, given.backend)}
    text = json.dumps(found, indent=2)
    print(text)
    if given.out:
        given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
