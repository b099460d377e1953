"""labbook for Python: a lab with a backend, and what it does for a study.

The verbs of the command line do their work by these methods; docs/python.md lists all that is public.
"""

from labbook.api.lab import Lab, PilotNeeded, effects_of_numerics
from labbook.api.results import Results
from labbook.api.run import Run
from labbook.plan.demand import Conflict
from labbook.warning import LabWarning

__all__ = ["Conflict", "Lab", "LabWarning", "PilotNeeded", "Results", "Run", "effects_of_numerics"]
