"""Backends are found by their entry points."""

from functools import cache
from importlib.metadata import entry_points

from labbook.backend.contract import Backend, Unsupported
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
    """The backend called `name`, ready to run.

    Raises BackendMissing with the reason if it is missing or broken, or if a package in its `requires` is not
    installed: packages are looked for here and imported later.
    """
    backend = load_to_plan(name)
    if reason := unready(backend):
        raise BackendMissing(reason)
    return backend


def unready(backend: Backend) -> str:
    """The package that `backend` lacks to run, with the remedy; empty if it lacks none."""
    name, missing = backend.capabilities.name, backend.missing()
    if not missing:
        return ""
    remedy = f"install it: pip install 'labbook[{name}]'"
    return f"the backend {name} needs the package {missing[0]}, which is not installed; {remedy}"


def load_to_plan(name: str) -> Backend:
    """The backend called `name`, for plans and keys: the packages that it runs with may be missing.

    Raises BackendMissing with the reason if it is missing or broken.
    """
    for entry in entry_points(group=GROUP):
        if entry.name == name:
            try:
                backend = entry.load()()
            except ImportError as error:
                raise BackendMissing(
                    f"the backend {name} cannot be loaded ({error}); try: pip install 'labbook[{name}]'"
                ) from error
            except TypeError as error:  # an abstract method is not defined
                raise BackendMissing(f"{entry.value} is no backend ({error}); see labbook.backend.Backend") from error
            if not isinstance(backend, Backend):
                raise BackendMissing(f"{entry.value} is no backend: derive it from labbook.backend.Backend")
            return backend
    known = ", ".join(sorted(installed())) or "none"
    raise BackendMissing(f"no backend is called {name}; there are: {known}")


def absent(backend: Backend, device: str) -> Unsupported:
    """That `backend` has no `device` (`cuda:0`, `cuda:all`) on this machine, with the devices that it has and what to
    do."""
    kind, known = device.partition(":")[0], backend.capabilities.devices
    there = [found.alias for found in backend.survey().devices]
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
