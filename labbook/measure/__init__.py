"""What is measured of a run: flow rates, profiles along the outlet, overlaps and energies, and the packing that it
started from."""

from labbook.measure.data import RunData
from labbook.measure.flow import FlowRate
from labbook.measure.ledger import EnergyLedger
from labbook.measure.measure import Evaluation, Measure, MeasureError, Quantity, Window
from labbook.measure.orifice import OrificeMeans
from labbook.measure.outlet import OutletProfiles
from labbook.measure.outlets import OutletRates
from labbook.measure.packing import PackingStructure
from labbook.measure.stress import ContactStress
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
        WallStress(),
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
