"""Maps of beds over a bottom that turns, in the order of Pongo et al. (2022), and what they lack."""

from collections.abc import Sequence
from pathlib import Path

from labbook.fields import Fields
from labbook.measure.recorded import FEWEST
from labbook.report import figures
from labbook.report.blocks import Picture, picture
from labbook.report.sections import PATTERNS
from labbook.results.points import PointResult
from labbook.results.recorded import Flowing, flow_patterns, moments
from labbook.results.rotation import Rotation, turning_at

_FEW = 3


def maps(curves: Sequence[Rotation], folder: Path) -> tuple[list[Picture], list[str]]:
    """Pictures of recorded runs and sentences on what is lacking. Raises ImportError without Numba."""
    pictures: list[Picture] = []
    lacking: set[str] = set()
    for number, curve in enumerate(curves, start=1):
        filmed = [k for k, one in enumerate(curve.points) if _filmed(one)]
        found, without = _of(curve, [curve.points[k] for k in chosen(curve, filmed)])
        suffix = f"-{number}" if len(curves) > 1 else ""
        where = ", ".join(filter(None, (curve.shape, curve.label)))
        for name, alt, caption, figure in found:
            whole = f"{where[:1].upper()}{where[1:]}. {caption}"
            pictures.append(picture(figure, folder / f"rotation-{name}{suffix}", f"{alt}, {where}", whole))
        lacking |= set(without)
    if not pictures and not lacking:
        lacking.add("Maps need recorded runs: add `record: {every: 100 ms, replicates: 1}`.")
    return pictures, sorted(lacking)


def chosen(curve: Rotation, known: Sequence[int]) -> list[int]:
    """Of known points the one at rest, the one of the smallest flow and the fastest; all, if they are no more."""
    if len(known) <= _FEW:
        return list(known)
    return sorted({known[0], next((k for k in known[1:] if k == curve.lowest()), known[1]), known[-1]})


def _of(curve: Rotation, points: Sequence[PointResult]):
    """File name, what it shows in words, caption and figure of every map of these points; what is lacking."""
    found, lacking = [], []
    rows = [row for result in points if (row := moments(result))]
    # grains hardly move within an instant, but the bed shakes: velocities take more frames than positions
    quick = [row for row in rows if all(one.frames >= FEWEST for one in row)]
    if rows:
        found.append(("packing", "packing fraction", _PACKING, figures.packing_maps(rows)))
    if quick:
        found.append(("speed", "speed", _SPEED, figures.speed_maps(quick)))
    if len(quick) < len(points):
        lacking.append("Maps of speed at instants need frames 100 ms apart or closer: `record: {every: 100 ms}`.")
    patterns = [every[0] for result in points if (every := flow_patterns(result))]
    if patterns:
        titles = [turning_at(one.result) for one in patterns]
        found.append(("patterns", "how the beds flow", PATTERNS, figures.flow_patterns(patterns, titles)))
        if all(one.fields.axes is not None for one in patterns):
            found.append(("order", "orientation", _ORDER, figures.order_maps(patterns)))
        if pressed := [(one, stress) for one in patterns if (stress := _stress(one)) is not None]:
            found.append(("pressure", "contact pressure", _PRESSURE, figures.pressure_maps(pressed)))
    return found, lacking


def _filmed(result: PointResult) -> bool:
    return any(run.recorded for run in result.runs)


def _stress(pattern: Flowing) -> Fields | None:
    """Fields with the contact stress of the first run of a point that has them."""
    return next((run.stress for run in pattern.result.runs if run.stress is not None), None)


_PACKING = (
    "Packing fraction in a plane through the axis, mean over the azimuth and 1 s (or a third of the window of the flow "
    "rate, if that is shorter) about three instants, of the first recorded run (Pongó et al. 2022, Fig. 6)."
)
_SPEED = (
    f"Speed in that plane at the same instants, of {FEWEST} frames and more each, with streamlines (Pongó et al. 2022, "
    "Fig. 7); hatched: stagnant, as in the next figure."
)
_ORDER = (
    "Orientation of rods in the window, mean over the azimuth: above O_zz, the mean square of the cosine to the "
    "vertical, below the order S; of directions at random both are 1/3."
)
_PRESSURE = "Contact pressure, a third of the trace of the contact stress, mean over the azimuth and the window."
