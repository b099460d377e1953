"""The picture of the README, from runs of the quick start: grains coloured by speed, and the fit of W against D.

    labbook run studies/quickstart.yaml --lab LAB
    python benchmarks/readme_picture.py LAB docs/quickstart.png
"""  # fmt: skip

import argparse
import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import labbook
from labbook.report import figures, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STUDY = Path(__file__).parents[1] / "studies" / "quickstart.yaml"
POINT = 4
PIXELS = 760
"""Height of the picture."""


def grains(run: labbook.Run) -> "Figure":
    """Grains of a recorded run in the middle of its window, coloured by speed on a scale of square roots."""
    from matplotlib.collections import EllipseCollection
    from matplotlib.colors import PowerNorm
    from matplotlib.figure import Figure

    scene, paths = run.point.scene, run.trajectories()
    assert run.trace is not None
    assert run.trace.window is not None
    frame = int(np.argmin(np.abs(paths.time - np.mean(run.trace.window))))
    x, speed = 1e3 * paths.x[frame], np.linalg.norm(paths.v[frame], axis=1)
    inside = np.isfinite(x).all(axis=1)
    width = np.full(int(inside.sum()), 1e3 * scene.grains.diameter)
    with style.house():
        figure = Figure(figsize=(style.COLUMN * 0.56, style.COLUMN * 1.16))
        ax = figure.subplots()
        beds = EllipseCollection(
            width, width, np.zeros(len(width)), units="xy", offsets=x[inside][:, [0, 2]], transOffset=ax.transData,
            array=speed[inside], cmap="viridis", norm=PowerNorm(0.5, 0.0, 0.75), edgecolors="white", linewidths=0.3,
        )  # fmt: skip
        ax.add_collection(beds)
        for wall in scene.container.walls():
            for (x0, z0), (x1, z1) in wall.shape.section():
                ax.plot([1e3 * x0, 1e3 * x1], [1e3 * z0, 1e3 * z1], color=style.INK, linewidth=1.2)
        ax.set_aspect("equal")
        ax.set_ylim(-8, float(x[inside][:, 2].max()) + 8)
        ax.set_axis_off()
        bar = figure.colorbar(beds, ax=ax, label="speed [m/s]", location="bottom", shrink=0.8, extend="max", pad=0.02)
        bar.set_ticks([0, 0.05, 0.2, 0.5])
    return figure


def main() -> None:
    """Write the picture."""
    from PIL import Image

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("lab", type=Path)
    parser.add_argument("picture", type=Path)
    given = parser.parse_args()
    results = labbook.Lab(given.lab).results(labbook.load(STUDY))
    (series,) = results.series
    parts = []
    for figure in (grains(results.run(point=POINT, seed=1)), figures.flow_against_orifice(series)):
        part = Image.open(io.BytesIO(style.for_a_screen(figure)[0])).convert("RGB")
        parts.append(part.resize((round(part.width * PIXELS / part.height), PIXELS), Image.Resampling.LANCZOS))
    picture = Image.new("RGB", (sum(part.width for part in parts), PIXELS), "white")
    for k, part in enumerate(parts):
        picture.paste(part, (sum(one.width for one in parts[:k]), 0))
    picture.quantize(256).save(given.picture, optimize=True)
    print(given.picture, picture.size)


if __name__ == "__main__":
    main()
