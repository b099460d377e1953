"""Figures of a report; each function returns a matplotlib figure in the house style and writes nothing."""

from labbook.report.figures.acceleration import acceleration_against_height
from labbook.report.figures.flow import flow_against_time
from labbook.report.figures.orifice import flow_against_orifice, overview
from labbook.report.figures.outlets import outlets_of_all
from labbook.report.figures.parameters import parameters_against
from labbook.report.figures.pattern import flow_patterns
from labbook.report.figures.position import shape_against_position
from labbook.report.figures.profiles import outlet_middles, outlet_profiles
from labbook.report.figures.ratios import flow_against_angle, flow_against_position

__all__ = [
    "acceleration_against_height",
    "flow_against_angle",
    "flow_against_orifice",
    "flow_against_position",
    "flow_against_time",
    "flow_patterns",
    "outlet_middles",
    "outlet_profiles",
    "outlets_of_all",
    "overview",
    "parameters_against",
    "shape_against_position",
]
