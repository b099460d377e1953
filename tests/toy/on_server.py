"""A pytest plugin: every lab that is made keeps its index on the PostgreSQL server of LABBOOK_TEST_SERVER.

Tests copy labs. A copy has no index there until somebody writes to it: here that is done before it is read.
"""

import os

from labbook.lab import server
from labbook.lab.catalogue import Catalogue
from labbook.lab.database import NoCatalogue
from labbook.lab.index import Index

_URL = os.environ["LABBOOK_TEST_SERVER"]
_told, _open = server.address, Catalogue._open


def address(lab):
    """That of the lab; a lab with none gets one as soon as its folder is there."""
    if (place := _told(lab)) is None and lab.folder.is_dir() and not lab.catalogue.exists():
        server.move_to(lab, _URL)
        place = _told(lab)
    return place


def opened(self):
    """The index of a lab, made if there is none yet."""
    try:
        return _open(self)
    except NoCatalogue as problem:
        if "is missing" not in str(problem) or _told(self.lab) is None:
            raise
    Index(self.lab).close()
    return _open(self)


server.address = address
Catalogue._open = opened
