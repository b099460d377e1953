"""Measures of a run: flow rates, clogging, profiles along the outlet, overlaps, energies, and its packing."""

from labbook.measure.arch import Arch
from labbook.measure.bulk_stress import BulkStress
from labbook.measure.clogging import Clogging
from labbook.measure.composition import Composition
from labbook.measure.data import RunData
from labbook.measure.energy import EnergyBalance
from labbook.measure.flow import FlowRate
from labbook.measure.ledger import EnergyLedger
from labbook.measure.measure import Evaluation, Measure, MeasureError, Quantity, Window
from labbook.measure.orifice import OrificeMeans
from labbook.measure.outlet import OutletProfiles
from labbook.measure.outlets import OutletRates
from labbook.measure.packing import PackingStructure
from labbook.measure.part_forces import MovingPartForces
from labbook.measure.planes import PlaneRates
from labbook.measure.residence import Residence
from labbook.measure.stress import ContactStress
from labbook.measure.velocities import Velocities
from labbook.measure.wall_stress import WallStress
from labbook.plugins import Registry

MEASURES: Registry[Measure] = Registry[Measure](
    "labbook.measures",
    Measure,
    (
        FlowRate(),
        OutletProfiles(),
        PackingStructure(),
        OrificeMeans(),
        ContactStress(),
        EnergyLedger(),
        OutletRates(),
        PlaneRates(),
        Composition(),
        Residence(),
        EnergyBalance(),
        Clogging(),
        Arch(),
        WallStress(),
        BulkStress(),
        Velocities(),
        MovingPartForces(),
    ),
)
"""The measures that a study can name under `measure`: those built in, and those of other packages."""

__all__ = [
    "MEASURES",
    "Evaluation",
    "Measure",
    "MeasureError",
    "Quantity",
    "RunData",
    "Window",
]
