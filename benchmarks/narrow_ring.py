"""Does W depend on how wide the ring of bottom around an outlet is? Flat-bottomed cylinders of several diameters.

Beds of equal height are discharged through outlets from 4.5 d to 7.5 d. Of every diameter D_c and outlet D: the flow
rate W with its standard error, the same relative to the widest silo, W in successive parts of the discharge, and the
mobile share of the ring, which is the part of the grains that stood on the bottom outside the outlet and have left by
the end. A ring whose grains leave flows as a plug; one whose grains stay is a stagnant zone.

    python benchmarks/narrow_ring.py --lab LAB --beds 12 --backend warp --device cuda:0 --out FILE
    python benchmarks/narrow_ring.py --lab LAB --beds 4 --diameters 33 48 --outlets 16.5 18 19.5 --until 0.35

Runs that the lab has are not made again.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import labbook
from labbook.backend.machine import hardware
from labbook.lab.packings import read_packing
from labbook.results.points import FLOW_RATE
from labbook.scene.packing import Packing

DIAMETER = 3.0
"""Of a grain [mm]."""
DIAMETERS = (30.0, 33.0, 36.0, 48.0)
"""Diameters of silos [mm]: 10, 11, 12 and 16 d."""
OUTLETS = (13.5, 15.0, 16.5, 18.0, 19.5, 21.0, 22.5)
"""Diameters of outlets [mm]: 4.5 d to 7.5 d."""
PARTS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6)
"""Parts of the mass between which W is also measured."""
ON_BOTTOM = 0.6
"""Height of the centre [d] below which a grain stands on the bottom."""


def study(width: float, outlets: Sequence[float], beds: int, until: float = PARTS[-1]) -> labbook.Study:
    """The study of one silo of `width` [mm], with as many grains as a bed of equal height takes, up to a part of the
    mass."""
    return labbook.define(
        name=f"narrow-ring-{width:g}",
        grains={
            "shape": "sphere", "diameter": f"{DIAMETER} mm", "density": "2500 kg/m^3",
            "count": round(2000 * (width / 33) ** 2),
        },
        contact={
            "law": "hertz-mindlin", "youngs_modulus": "12 MPa", "poisson_ratio": 0.22, "friction": 0.5,
            "rolling_friction": 0.01, "restitution": 0.5,
        },
        container={"kind": "cylinder-silo", "diameter": f"{width} mm", "height": "140 mm", "orifice": "18 mm"},
        walls={"all": {"friction": 0.3}},
        sweep={"container.orifice": f"{list(outlets)} mm"},
        window={"start": 0.15, "end": 0.3},
        stop={"discharged": until},
        numerics={"precision": "mixed"},
        replicates=beds,
        measure=["flow_rate"],
    )  # fmt: skip


def mobile(packing: Packing, gone: np.ndarray, outlet: float) -> float:
    """Share of the grains that stood on the bottom outside the outlet [m] and are among those `gone` (ids)."""
    d = 1e-3 * DIAMETER
    ring = (packing.x[:, 2] < ON_BOTTOM * d) & (np.hypot(packing.x[:, 0], packing.x[:, 1]) > outlet / 2 + d / 2)
    assert packing.ids is not None
    return float(np.isin(packing.ids[ring], gone).mean()) if ring.any() else np.nan


def rows(lab: labbook.Lab, studied: labbook.Study, width: float, until: float) -> Iterator[dict[str, Any]]:
    """Of every point: W of all beds [g/s], W in parts of the mass, the mobile share of the ring, and clogged runs."""
    reached = [part for part in PARTS if part <= until]
    for point in lab.results(studied, progress=False).points:
        outlet = point.point.scene.container.outlets[0].width
        rates, parts, shares, clogged = [], [], [], 0
        for run in point.runs:
            measured = run.measured.get(FLOW_RATE)
            if measured is None or not np.isfinite(measured.value):
                clogged += 1
                continue
            crossing = run.run.data().tables["crossing"]
            grains = point.point.scene.grains
            order = np.argsort(crossing["time"])
            times, left = np.asarray(crossing["time"])[order], np.asarray(crossing["id"])[order]
            at = np.interp(np.array(reached) * grains.count, np.arange(1, len(times) + 1), times)
            parts.append(1e3 * grains.mass * grains.count * np.diff(reached) / np.diff(at))
            _, packing = read_packing(lab.lab_folder.packing(run.packing_key))
            shares.append(mobile(packing, left[: round(until * grains.count)], outlet))
            rates.append(1e3 * measured.value)
        yield {
            "D_c [mm]": width, "D [mm]": round(1e3 * outlet, 6), "ring [d]": (width - 1e3 * outlet) / 2 / DIAMETER,
            "beds": len(rates), "clogged": clogged, "W [g/s]": rates, "parts [g/s]": np.array(parts).tolist(),
            "mobile": shares,
        }  # fmt: skip


def table(found: Sequence[dict[str, Any]]) -> str:
    """Lines of text: W with its standard error, W in parts over W of the window, and the mobile share."""
    lines = [f"D_c  D     ring  beds  W [g/s]         mobile  W of parts {PARTS} over W"]
    for row in found:
        if row["beds"] < 2:
            lines.append(f"{row['D_c [mm]']:g}  {row['D [mm]']:g}  {row['beds']} beds flowed")
            continue
        rates = np.array(row["W [g/s]"])
        parts = np.mean(row["parts [g/s]"], axis=0) / rates.mean()
        error = rates.std(ddof=1) / np.sqrt(len(rates))
        lines.append(
            f"{row['D_c [mm]']:<4g} {row['D [mm]']:<5g} {row['ring [d]']:.2f}  {row['beds']:<4} "
            f"{rates.mean():6.2f} ± {error:4.2f}   {np.nanmean(row['mobile']):.2f}    "
            + " ".join(f"{part:.2f}" for part in parts)
        )
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, print, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lab", type=Path, required=True)
    parser.add_argument("--beds", type=int, default=12)
    parser.add_argument("--diameters", type=float, nargs="+", default=DIAMETERS, help="Of silos [mm].")
    parser.add_argument("--outlets", type=float, nargs="+", default=OUTLETS, help="Diameters [mm].")
    parser.add_argument("--until", type=float, default=PARTS[-1], help="Part of the mass at which runs end.")
    parser.add_argument("--backend", default="numba")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lab = labbook.Lab(options.lab, options.backend, options.device)
    found = []
    for width in options.diameters:
        outlets = [outlet for outlet in options.outlets if outlet < width - DIAMETER]
        studied = study(width, outlets, options.beds, options.until)
        lab.run(studied, progress=False)
        found += rows(lab, studied, width, options.until)
        print(table(found), flush=True)
        if options.out:  # after each silo: what is done is kept if the time is up
            result = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "hardware": hardware(), "rows": found}
            options.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
