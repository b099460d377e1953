"""Continuum fields of grains by coarse-graining: density, velocity, stresses, orientation."""

from labbook.fields.fields import Fields, coarse_grain, nematic_order
from labbook.fields.grids import Grid, Layer, Ring, Space
from labbook.fields.orifice import orifice_mean, orifice_means
from labbook.fields.pattern import Pattern, pattern_of
from labbook.fields.rows import ContactRows, GrainRows, axes, contacts_of, grains_of

__all__ = [
    "ContactRows",
    "Fields",
    "GrainRows",
    "Grid",
    "Layer",
    "Pattern",
    "Ring",
    "Space",
    "axes",
    "coarse_grain",
    "contacts_of",
    "grains_of",
    "nematic_order",
    "orifice_mean",
    "orifice_means",
    "pattern_of",
]
