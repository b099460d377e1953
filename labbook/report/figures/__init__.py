"""Figures of a report; each function returns a matplotlib figure in the house style and writes nothing."""

from labbook.report.figures.acceleration import acceleration_against_height
from labbook.report.figures.against import against_key, has_cuts, ratio_heading
from labbook.report.figures.arch import arch_figure, stopped_bed
from labbook.report.figures.clogging import clogging_figure
from labbook.report.figures.composition import composition_against_discharge
from labbook.report.figures.energy import energy_balance
from labbook.report.figures.flow import flow_against_time
from labbook.report.figures.map import design_map
from labbook.report.figures.orifice import flow_against_orifice, overview
from labbook.report.figures.parameters import parameters_against
from labbook.report.figures.pattern import flow_patterns
from labbook.report.figures.posterior import posterior_figure
from labbook.report.figures.residence import residence_distributions, residence_maps
from labbook.report.figures.starts import parameters_against_start

__all__ = [
    "acceleration_against_height",
    "against_key",
    "arch_figure",
    "clogging_figure",
    "composition_against_discharge",
    "design_map",
    "energy_balance",
    "flow_against_orifice",
    "flow_against_time",
    "flow_patterns",
    "has_cuts",
    "overview",
    "parameters_against",
    "parameters_against_start",
    "posterior_figure",
    "ratio_heading",
    "residence_distributions",
    "residence_maps",
    "stopped_bed",
]
