"""Avalanches of one study in two labs, made by two backends: logrank test of their sizes at each point.

    labbook run studies/clogging-layer.yaml --lab CPU --backend numba
    labbook run studies/clogging-layer.yaml --lab GPU --backend warp --device cuda:0
    python benchmarks/clogging_backends.py CPU GPU

Sizes are the grains beyond the transient of each start; avalanches without a stop are censored. Of each point it prints
the stops and grains of both labs, their probabilities of a stop per grain, and p of the hypothesis that both labs have
one distribution. Avalanches of one bed are taken as independent.
"""

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.stats import CensoredData, logrank

from labbook.lab.runs import open_run
from labbook.measure.clogging import avalanches

Sizes = dict[str, tuple[np.ndarray, np.ndarray]]
"""By label of the point: grains of each avalanche beyond its transient, and whether a stop ended it."""


def sizes(lab: Path) -> Sizes:
    """Read the avalanches of all runs of a lab."""
    parts: dict[str, list[tuple[np.ndarray, np.ndarray]]] = defaultdict(list)
    for folder in sorted((lab / "runs").iterdir()):
        record, data = open_run(folder)
        of_run = avalanches(data, record.observe)
        counts = of_run.counted > 0
        parts[record.label].append((of_run.counted[counts], of_run.stopped[counts]))
    return {label: (np.concatenate(first), np.concatenate(second)) for label, own in parts.items()
            for first, second in [zip(*own, strict=True)]}  # fmt: skip


def main() -> None:
    """Print a row of each point that both labs have."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path)
    args = parser.parse_args()
    first, second = sizes(args.first), sizes(args.second)
    print("| point | stops, grains | stops, grains | q | q | p of the logrank test |\n|---|---|---|---|---|---|")
    for label in sorted(first.keys() & second.keys()):
        both = first[label], second[label]
        left, right = (CensoredData.right_censored(grains, ~stopped) for grains, stopped in both)
        stops = sum(int(stopped.sum()) for _, stopped in both)
        p = f"{logrank(left, right).pvalue:.2g}" if stops else "no stops"
        counts = " | ".join(f"{stopped.sum()}, {grains.sum()}" for grains, stopped in both)
        rates = " | ".join(f"{stopped.sum() / grains.sum():.2g}" for grains, stopped in both)
        print(f"| {label} | {counts} | {rates} | {p} |")


if __name__ == "__main__":
    main()
