"""labbook: studies of granular silos, from a YAML file or from Python to a report with error bars.

The import is fast: backends, viewer, index and plotting libraries are loaded at their first use. docs/python.md
lists all names.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from labbook.version import __version__

if TYPE_CHECKING:
    from labbook.api import Lab, Results, Run
    from labbook.fit import FitError, FitResult
    from labbook.lab import LabError
    from labbook.measure.trajectories import Trajectories
    from labbook.plan.plan import Plan
    from labbook.run.summary import Summary
    from labbook.scene import Scene
    from labbook.study import Point, Study, StudyError, define
    from labbook.study.load import load  # not from the package: mypy would take the module of that name
    from labbook.warning import LabWarning

__all__ = [
    "FitError",
    "FitResult",
    "Lab",
    "LabError",
    "LabWarning",
    "Plan",
    "Point",
    "Results",
    "Run",
    "Scene",
    "Study",
    "StudyError",
    "Summary",
    "Trajectories",
    "__version__",
    "define",
    "load",
]

_PLACES = {
    "labbook.api": ("Lab", "Results", "Run"),
    "labbook.fit": ("FitError", "FitResult"),
    "labbook.lab": ("LabError",),
    "labbook.measure.trajectories": ("Trajectories",),
    "labbook.plan.plan": ("Plan",),
    "labbook.run.summary": ("Summary",),
    "labbook.scene": ("Scene",),
    "labbook.study": ("Point", "Study", "StudyError", "define", "load"),
    "labbook.warning": ("LabWarning",),
}
_PLACE = {name: module for module, names in _PLACES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name at its first use."""
    if name not in _PLACE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_PLACE[name]), name)
    return value


def __dir__() -> list[str]:
    """All public names, imported or not."""
    return sorted({*globals(), *_PLACE})


def load_ipython_extension(shell: Any) -> None:
    """Turn on completion within quotes: `%load_ext labbook` in a notebook."""
    import_module("labbook.completion").install(shell)
