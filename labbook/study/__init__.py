"""From a YAML file to a study: units, sweeps, strict keys, and problems told by file, line, key and remedy."""

from labbook.study.load import load
from labbook.study.problems import Problem, StudyError
from labbook.study.schema import Accuracy, Fill, Record, Reference, ReferenceEntry, Statement, Stop, Window
from labbook.study.study import Point, Study

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
    "load",
]
