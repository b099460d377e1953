"""From a YAML file to a study: units, sweeps, strict keys, and problems told by file, line, key and remedy."""

from labbook.study.load import Study, define, load
from labbook.study.point import Point
from labbook.study.problems import Problem, StudyError
from labbook.study.schema import Accuracy, Fill, Record, Reference, ReferenceEntry, Statement, Stop, Window

__all__ = [
    "Accuracy",
    "Fill",
    "Point",
    "Problem",
    "Record",
    "Reference",
    "ReferenceEntry",
    "Statement",
    "Stop",
    "Study",
    "StudyError",
    "Window",
    "define",
    "load",
]
