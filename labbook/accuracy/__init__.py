"""The measured effect of numerics on a flow rate, and the numerics that a requested error allows."""

from labbook.accuracy.calibration import (
    BESIDE,
    Bias,
    Calibration,
    Effects,
    NotMeasured,
    OutOfRange,
    SimilarScenes,
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
    "Bias",
    "Calibration",
    "Choice",
    "Effects",
    "Groups",
    "NotMeasured",
    "OutOfRange",
    "SimilarScenes",
    "bias_of",
    "calibration",
    "choose",
    "extend",
    "groups",
    "load",
    "shipped",
    "write",
]
