"""Former name of the module `platform`, for cases of other packages: reading a name from it warns."""

import warnings
from typing import Any

from labbook.checks.verify import platform
from labbook.warning import caller

_RENAMED = {"Stand": "Platform", "Motion": "Trajectory"}


def __getattr__(name: str) -> Any:
    value = getattr(platform, _RENAMED.get(name, name))
    message = f"{__name__}.{name} is now {platform.__name__}.{_RENAMED.get(name, name)}"
    warnings.warn_explicit(message, DeprecationWarning, *caller())
    return value
