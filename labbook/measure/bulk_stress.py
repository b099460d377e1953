"""Vertical force through horizontal sections of a bed, from the coarse-grained stress of its contacts."""

import math
from dataclasses import dataclass

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe
from labbook.fields import Layer, coarse_grain
from labbook.measure.bed import cells, omega_of
from labbook.measure.data import RunData
from labbook.measure.measure import (
    Evaluation,
    Measure,
    MeasureError,
    Quantity,
    Window,
    as_arrays,
    flow_suffix,
    from_arrays,
    while_flowing,
)
from labbook.measure.stress import bed_rows, contact_frames
from labbook.measure.wall_stress import steady_part
from labbook.scene import Scene
from labbook.stats import Measured

NAME = "bulk_stress"
_REACH = 4.0
"""Reach of the coarse-graining function, in its widths."""
_LOAD = Quantity("section_load", "F_zz/(M g)_above", "", "vertical contact force through the section that has half of "
                 "the weight above it, over that weight")  # fmt: skip


@dataclass(frozen=True, eq=False)
class SectionForces:
    """Mean vertical force through horizontal sections of the bed, over the frames of the steady part.

    Attributes:
        z: Heights of the sections [m], shape [k].
        force: Contact stress sigma_zz integrated over each section [N], positive in compression, shape [k].
        weight_above: Weight above each section [N], from the field of the density, shape [k].
        frames: Number of frames.
    """

    z: np.ndarray
    force: np.ndarray
    weight_above: np.ndarray
    frames: int

    @classmethod
    def of(cls, evaluation: Evaluation) -> "SectionForces | None":
        """Read the forces from an evaluation; None without any."""
        return from_arrays(cls, evaluation.arrays)

    def at(self, heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Interpolate force and weight above [N] at heights [m] linearly between those of `z`."""
        return np.interp(heights, self.z, self.force), np.interp(heights, self.z, self.weight_above)


class BulkStress(Measure):
    """Measure the vertical contact force through horizontal sections of the bed.

    This is a source of sigma_zz that does not use forces at walls; with `wall_stress` reports compare both. The stress
    is coarse-grained (Goldhirsch, Granul. Matter 12 (2010) 239) in the window of the flow rate, or in the second half
    of the run of a closed container. Positions and all contacts of the bed are recorded: use it for short runs of small
    beds.

    Quantities:
        section_load: Vertical force through the section with half of the weight above it, over that weight.

    Arrays:
        z, force, weight_above, frames: Those of `SectionForces`.

    Raises:
        MeasureError: There is no gravity.
    """

    name = NAME
    version = 1
    declared = (_LOAD, while_flowing(_LOAD))

    def check(self, scene: Scene) -> None:
        if scene.gravity == 0:
            reason = f"{NAME} compares forces with the weight of the bed, and there is no gravity"
            raise MeasureError(reason, f"take {NAME} out of measure, or use a gravity above 0 m/s^2")

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        return self.observed(scene, numerics)

    def observed(self, scene: Scene, numerics: Numerics, window: Window | None = None) -> tuple[Probe, ...]:
        self.check(scene)
        plane, frames = scene.container.outlet_plane, contact_frames(scene, numerics, window)
        return frames if plane is None else (Crossing(plane), *frames)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        if not {"sample", "contacts"} <= set(run.tables):
            raise MeasureError(f"{NAME}: the run recorded no contacts; run it again with this measure")
        begin, end, where = steady_part(run, window)
        forces = section_forces(run, begin, end)
        name, how = f"{_LOAD.name}{flow_suffix(run)}", "contacts, coarse-grained; error from seeds only"
        if forces is None:
            return Evaluation((Measured(name, math.nan, math.nan, 0, where, how, "", "no frame within the window"),))
        above = float(forces.weight_above[0]) / 2
        middle = np.interp([-above], -forces.weight_above, forces.z)
        load = float(forces.at(middle)[0][0]) / above
        return Evaluation((Measured(name, load, math.nan, forces.frames, where, how, ""),), as_arrays(forces))


def section_forces(run: RunData, begin: float, end: float) -> SectionForces | None:
    """Compute forces through sections of the bed from the frames between two times [s]; None without a frame.

    Grains and contacts are projected on a vertical plane, so that the kernels are discs. Integrated along it, sections
    lose nothing to walls.
    """
    rows = bed_rows(run, begin, end)
    if rows is None:
        return None
    grains, contacts = rows
    omega = omega_of(run.scene)
    reach = _REACH * omega + run.scene.grains.extent
    (low, bottom), (high, top) = ((extreme(grains.x[:, 0]), extreme(grains.x[:, 2])) for extreme in (np.min, np.max))
    x, z = (float(low - reach), float(high + reach)), (float(bottom - reach), float(top + reach))
    grid = Layer(x, z, cells(x[1] - x[0], omega), cells(z[1] - z[0], omega / 2), 1.0)
    fields = coarse_grain(grid, omega, grains, contacts)
    assert fields.contact_stress is not None
    heights, across = grid.points
    width, step = across[1] - across[0], heights[1] - heights[0]
    weight = fields.density.sum(axis=1) * width * step * run.scene.gravity
    above = np.cumsum(weight[::-1])[::-1] - weight / 2  # above the middle of each row of cells
    return SectionForces(heights, fields.contact_stress[2, 2].sum(axis=1) * width, above, grains.frames)
