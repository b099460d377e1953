"""The lab's runs, packings and measured numbers: kept in folders, indexed in SQLite, asked through
`Catalogue`."""

from labbook.catalogue.catalogue import Catalogue, Entry
from labbook.catalogue.connect import NoCatalogue
from labbook.catalogue.finished import FinishedRun
from labbook.catalogue.lab import DiskFull, Lab, Unusable
from labbook.catalogue.parts import Unreadable
from labbook.catalogue.record import RunRecord

__all__ = ["Catalogue", "DiskFull", "Entry", "FinishedRun", "Lab", "NoCatalogue", "RunRecord", "Unreadable", "Unusable"]
