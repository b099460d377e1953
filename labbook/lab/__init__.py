"""Storage of runs, packings and measured numbers: folders, indexed in SQLite and queried through `Catalogue`."""

from labbook.lab.catalogue import Catalogue, Entry
from labbook.lab.database import NoCatalogue
from labbook.lab.evaluations import FinishedRun
from labbook.lab.folder import DiskFull, LabError, LabFolder
from labbook.lab.records import RunRecord, Unreadable

__all__ = [
    "Catalogue",
    "DiskFull",
    "Entry",
    "FinishedRun",
    "LabError",
    "LabFolder",
    "NoCatalogue",
    "RunRecord",
    "Unreadable",
]
