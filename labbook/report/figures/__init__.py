"""Figures of a report; each function returns a matplotlib figure in the house style and writes nothing."""

from labbook.report.figures.acceleration import acceleration_against_height
from labbook.report.figures.against import against_key, ratio_heading
from labbook.report.figures.flow import flow_against_time
from labbook.report.figures.maps import order_maps, packing_maps, pressure_maps, speed_maps
from labbook.report.figures.orifice import flow_against_orifice, overview
from labbook.report.figures.outlets import outlets_of_all
from labbook.report.figures.parameters import parameters_against
from labbook.report.figures.pattern import flow_patterns
from labbook.report.figures.position import shape_against_position
from labbook.report.figures.profiles import outlet_middles, outlet_profiles
from labbook.report.figures.ratios import flow_against_angle, flow_against_position
from labbook.report.figures.rotation import (
    above_orifice,
    acceleration_against_rotation,
    drop_and_rise,
    flow_against_rotation,
)
from labbook.report.figures.scaling import flow_scaling

__all__ = [
    "above_orifice",
    "acceleration_against_height",
    "acceleration_against_rotation",
    "against_key",
    "drop_and_rise",
    "flow_against_angle",
    "flow_against_orifice",
    "flow_against_position",
    "flow_against_rotation",
    "flow_against_time",
    "flow_patterns",
    "flow_scaling",
    "order_maps",
    "outlet_middles",
    "outlet_profiles",
    "outlets_of_all",
    "overview",
    "packing_maps",
    "parameters_against",
    "pressure_maps",
    "ratio_heading",
    "shape_against_position",
    "speed_maps",
]
