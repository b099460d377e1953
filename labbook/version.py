"""The version of labbook: the build of the package and all rooms read it here."""

__version__ = "0.1.0"
