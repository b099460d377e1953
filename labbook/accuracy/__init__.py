"""The measured effect of numerics on a flow rate, and the numerics that a requested error allows."""

from labbook.accuracy.calibration import (
    BESIDE,
    Alike,
    Bias,
    Calibration,
    Effects,
    NotMeasured,
    OutOfRange,
    calibration,
    extend,
    load,
    shipped,
    write,
)
from labbook.accuracy.choosing import Choice, bias_of, choose
from labbook.accuracy.groups import Groups, groups

__all__ = [
    "BESIDE",
    "Alike",
    "Bias",
    "Calibration",
    "Choice",
    "Effects",
    "Groups",
    "NotMeasured",
    "OutOfRange",
    "bias_of",
    "calibration",
    "choose",
    "extend",
    "groups",
    "load",
    "shipped",
    "write",
]
