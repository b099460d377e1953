"""Stress that grains carry by their contacts, in a silo about an axis (Goldhirsch, Granul. Matter 12 (2010) 239)."""

import math
from collections.abc import Mapping

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Crossing, Probe, Sample
from labbook.fields import ContactRows, Fields, GrainRows, coarse_grain, contacts_of, orifice_mean
from labbook.measure.bed import bed_grid, grains_between, omega_of, round_outlet
from labbook.measure.data import RunData
from labbook.measure.expected import beats_of, rounded, window_time
from labbook.measure.measure import (
    Evaluation,
    Measure,
    MeasureError,
    Quantity,
    Window,
    flow_suffix,
    while_flowing,
    window_in_words,
)
from labbook.measure.scales import layer, moment
from labbook.measure.steady import outflow
from labbook.scene import Scene
from labbook.scene.timescales import gravity_time
from labbook.stats import Measured

NAME = "contact_stress"
_FRAMES = 5
"""Frames within the window, if the outflow is as expected; slower flows have more. Every contact of a bed is recorded,
some 30 bytes each: means over the azimuth of few frames already tell maps."""
_EVERY = 5.0
"""Time between two frames in a container without an outlet, in sqrt(d*/g)."""
_LARGEST_COUNT = 12
"""Frames that are coarse-grained, spread over the window: each contact costs as much as some fifteen grains."""
_PRESSURES = (
    Quantity("orifice_contact_pressure", "⟨p_c⟩", "Pa", "contact pressure of the layer above the orifice"),
    Quantity("bed_contact_pressure", "p_c in the bed", "Pa", "contact pressure of the bed, weighted by density"),
)


class ContactStress(Measure):
    """Measure the contact stress of the whole bed, coarse-grained within the window of the flow rate.

    The stress is that of Goldhirsch (Granul. Matter 12 (2010) 239). Positions, forces and branch vectors of all
    contacts are recorded, in single precision: about 0.8 MB a frame of 10 000 rods.

    Quantities:
        orifice_contact_pressure: A third of the trace, averaged above the orifice as `orifice` does [Pa].
        bed_contact_pressure: Its mean over the bed, weighted by density [Pa].

    Arrays:
        Those of `Fields`.

    Raises:
        MeasureError: The outlet is not round, grains differ, or there is no gravity.
    """

    name = NAME
    version = 2
    declared = (*_PRESSURES, *map(while_flowing, _PRESSURES))

    def check(self, scene: Scene) -> None:
        round_outlet(scene, NAME)
        if scene.gravity == 0:
            reason = "contact_stress looks at a multiple of sqrt(d/g), and there is no gravity"
            raise MeasureError(reason, "take contact_stress out of measure, or use a gravity above 0 m/s^2")

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        return self.observed(scene, numerics)

    def observed(self, scene: Scene, numerics: Numerics, window: Window | None = None) -> tuple[Probe, ...]:
        self.check(scene)
        return Crossing(round_outlet(scene, NAME).plane), *contact_frames(scene, numerics, window)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        outlet = round_outlet(run.scene, NAME)
        where = window_in_words(window, "grains")
        how = "contacts, coarse-grained; error from seeds only"
        mean = stress_fields(run, window)
        suffix = flow_suffix(run)
        if mean is None:
            note = "no frame within the window"
            none = (math.nan, math.nan, 0, where, how, "Pa", note)
            return Evaluation(tuple(Measured(f"{quantity.name}{suffix}", *none) for quantity in _PRESSURES))
        fields, frames = mean
        pressure = contact_pressure(fields)
        weight = fields.density * fields.grid.volumes
        means = {
            "orifice_contact_pressure": float(
                orifice_mean(fields, pressure, outlet.width, layer(run.scene, window), bottom=outlet.plane)
            ),
            "bed_contact_pressure": float((pressure * weight).sum() / weight.sum()),
        }
        common = (math.nan, frames, where, how, "Pa")
        return Evaluation(
            tuple(Measured(name + suffix, value, *common) for name, value in means.items()), fields.arrays()
        )


def contact_frames(scene: Scene, numerics: Numerics, window: Window | None) -> tuple[Sample, Contacts]:
    """List the probes of grains and contacts of the whole bed; measures of its stress share them, as they are equal."""
    time = min(rounded(window_time(scene) / _FRAMES, scene, 1), moment(scene, window))
    if scene.container.outlet_plane is None:
        time = _EVERY * gravity_time(scene)
    every = beats_of(time, numerics)
    return Sample(fields=("x", "v"), every=every), Contacts(every=every)


def contact_pressure(fields: Fields) -> np.ndarray:
    """Compute a third of the trace of the contact stress [Pa], of the grid's shape; positive in compression."""
    assert fields.contact_stress is not None
    return np.trace(fields.contact_stress) / 3


def stress_fields(run: RunData, window: Window) -> tuple[Fields, int] | None:
    """Compute fields with the contact stress of a run's bed within the window.

    Returns:
        The fields and the number of their frames; None without a frame.

    Raises:
        MeasureError: The run recorded no contacts.
        ImportError: Numba is not installed.
    """
    if not {"sample", "contacts"} <= set(run.tables):
        raise MeasureError("contact_stress: the run recorded no contacts; run it again with this measure")
    flow, _ = outflow(run, window)
    if flow is None:
        return None
    rows = bed_rows(run, flow.begin, flow.end)
    if rows is None:
        return None
    omega, (grains, touching) = omega_of(run.scene), rows
    grid = bed_grid(run.scene, omega, grains.x, coarse=True)
    return coarse_grain(grid, omega, grains, touching), grains.frames


def bed_rows(run: RunData, begin: float, end: float) -> tuple[GrainRows, ContactRows] | None:
    """Select grains and contacts of at most `_LARGEST_COUNT` frames between two times [s]; None without a frame."""
    sample, contacts = run.with_bodies(run.tables["sample"]), run.tables["contacts"]
    steps = np.unique(contacts["step"][(contacts["time"] >= begin) & (contacts["time"] <= end)])
    if not len(steps):
        return None
    spread = steps[np.linspace(0, len(steps) - 1, min(_LARGEST_COUNT, len(steps))).round().astype(int)]
    sample, contacts = (_frames(table, spread) for table in (sample, contacts))
    return grains_between(run.scene, sample, begin, end), contacts_of(contacts, sample, begin, end)


def _frames(table: Mapping[str, np.ndarray], steps: np.ndarray) -> dict[str, np.ndarray]:
    inside = np.isin(table["step"], steps)
    return {name: np.asarray(column)[inside] for name, column in table.items()}
