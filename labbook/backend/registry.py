"""Backends are found by their entry points."""

from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec

from labbook.backend.contract import Backend, Surveys, Unsupported
from labbook.plugins import Extension


class BackendMissing(Exception):
    """No such backend, or it cannot be loaded; the message says why and what to do."""


GROUP = "labbook.backends"


def installed() -> dict[str, str]:
    """Names of the installed backends and their entry points; none is imported."""
    return {entry.name: entry.value for entry in entry_points(group=GROUP)}


@cache
def extension_of(name: str) -> Extension | None:
    """The extension that provides the backend called `name`; None of bundled ones, and of one that is not installed."""
    return next((Extension.of(entry) for entry in entry_points(group=GROUP) if entry.name == name), None)


def load(name: str) -> Backend:
    """The backend called `name`. Raises BackendMissing with the reason if it is missing or broken.

    Backends import heavy modules late. The modules in their `requires` are looked for here, not imported.
    """
    for entry in entry_points(group=GROUP):
        if entry.name == name:
            try:
                backend = entry.load()()
            except ImportError as error:
                raise BackendMissing(
                    f"the backend {name} cannot be loaded ({error}); try: pip install 'labbook[{name}]'"
                ) from error
            for module in getattr(backend, "requires", ()):
                if find_spec(module) is None:
                    raise BackendMissing(
                        f"the backend {name} needs the package {module}, which is not installed; "
                        f"install it: pip install 'labbook[{name}]'"
                    )
            return backend
    known = ", ".join(sorted(installed())) or "none"
    raise BackendMissing(f"no backend is called {name}; there are: {known}")


def absent(backend: Backend, device: str) -> Unsupported:
    """That `backend` has no `device` (`cuda:0`, `cuda:all`) on this machine, with the devices that it has and what to
    do."""
    kind, known = device.partition(":")[0], backend.capabilities.devices
    there = [found.alias for found in backend.survey().devices] if isinstance(backend, Surveys) else known
    said = f"the backend {backend.capabilities.name} has no {device} here; it has {', '.join(there) or 'no device'}"
    ways = [f"use --device {alias}" for alias in there if alias != "cpu"][:1]
    if "cpu" in there:
        ways.append("use --device cpu or leave --device out")
    if kind not in {one.partition(":")[0] for one in known}:
        ways.append("use another backend (labbook doctor lists backends and devices)")
    elif kind not in {one.partition(":")[0] for one in there}:
        if backend.capabilities.name != "numba":
            ways.insert(0, "use --backend numba, which is faster on a CPU")
        ways.append(f"install the driver for {kind} devices (labbook doctor shows the devices found)")
    return Unsupported("--device", f"{said}; {', or '.join(ways)}")
