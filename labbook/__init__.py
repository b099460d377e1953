"""labbook: studies of granular silos, from a YAML file to a report with error bars.

Importing it is cheap: no backend, viewer, catalogue or plotting library is loaded until it is used.
"""

__version__ = "0.1.0"
