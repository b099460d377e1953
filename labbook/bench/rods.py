"""Speed with rods: Pongó's cylinder with few of them, settled, and flowing over its turning bottom."""

from collections.abc import Callable, Sequence

from labbook.backend import Backend
from labbook.backend.probes import Crossing
from labbook.bench.batch import CYLINDER_STEP, FILLING_STEP, OUTFLOW, SETTLED
from labbook.bench.beds import settled
from labbook.bench.rate import Rate, timed
from labbook.bench.scenes import cylinder
from labbook.filling.opening import opened

RODS = 1500  # few enough to settle within half a minute of processor time


def has_rods(backend: Backend) -> bool:
    """Whether the backend has rods in round silos."""
    can = backend.capabilities
    return "spherocylinder" in can.shapes and "frustum" in can.walls


def rod_rates(
    backend: Backend,
    repeats: int,
    say: Callable[[str], None],
    rods: int = RODS,
    precisions: Sequence[str] = ("double",),
) -> list[Rate]:
    """Rates in the closed cylinder and, from OUTFLOW [s] on, in the open one, in each of `precisions`.

    The bed settles with a larger time step than it is timed with.
    """
    scene = cylinder(rods=True, grains=rods)
    closed = scene.close()
    say(f"settling {rods} rods")
    bed = settled(backend, closed, CYLINDER_STEP.model_copy(update={"dt": FILLING_STEP}), SETTLED)
    start = opened(bed, closed, scene)
    rates = []
    for precision in precisions:
        numerics = CYLINDER_STEP.model_copy(update={"precision": precision})
        say(f"timing settled rods, {precision} (compiles)")
        rates.append(timed(backend, "rods settled", closed, numerics, bed, repeats))
        say(f"timing the discharge of rods, {precision} (compiles)")
        rates.append(timed(backend, "rods flowing", scene, numerics, start, repeats, [Crossing(0.0)], OUTFLOW))
    return rates
