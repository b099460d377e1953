"""Registry of backends, by entry points."""

from functools import cache
from importlib.metadata import entry_points

from labbook.backend.contract import Backend, Unsupported
from labbook.plugins import Extension


class BackendMissing(Exception):
    """The backend does not exist or cannot be loaded; the message gives reason and remedy."""


GROUP = "labbook.backends"


def installed() -> dict[str, str]:
    """Map names of installed backends to their entry points; none is imported."""
    return {entry.name: entry.value for entry in entry_points(group=GROUP)}


@cache
def extension_of(name: str) -> Extension | None:
    """Return the extension that provides a backend; None for bundled backends, and for one that is not installed."""
    return next((Extension.of(entry) for entry in entry_points(group=GROUP) if entry.name == name), None)


def load(name: str) -> Backend:
    """Load a backend that is ready to run.

    Packages in its `requires` are searched here, and imported later.

    Args:
        name: Name of the backend.

    Raises:
        BackendMissing: It is missing or broken, or a required package is not installed; with the reason.
    """
    backend = load_to_plan(name)
    if reason := unready(backend):
        raise BackendMissing(reason)
    return backend


def unready(backend: Backend) -> str:
    """Describe the package that `backend` lacks to run, with the remedy; empty if it lacks none."""
    name, missing = backend.capabilities.name, backend.missing()
    if not missing:
        return ""
    remedy = f"install it: pip install 'labbook[{name}]'"
    return f"the backend {name} needs the package {missing[0]}, which is not installed; {remedy}"


def load_to_plan(name: str) -> Backend:
    """Load a backend for plans and keys, for which packages that it needs to run may be missing.

    Args:
        name: Name of the backend.

    Raises:
        BackendMissing: It is missing or broken; with the reason.
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
    names = ", ".join(sorted(installed())) or "none"
    raise BackendMissing(f"no backend is called {name}; there are: {names}")


def absent(backend: Backend, device: str) -> Unsupported:
    """Build the error for a device that `backend` does not have on this machine (`cuda:0`, `cuda:all`).

    Its message lists the present devices and the remedies.
    """
    kind, kinds = device.partition(":")[0], backend.capabilities.devices
    there = [device_found.alias for device_found in backend.survey().devices]
    reason = f"the backend {backend.capabilities.name} has no {device} here; it has {', '.join(there) or 'no device'}"
    ways = [f"use --device {alias}" for alias in there if alias != "cpu"][:1]
    if "cpu" in there:
        ways.append("use --device cpu or leave --device out")
    if kind not in {alias.partition(":")[0] for alias in kinds}:
        ways.append("use another backend (labbook doctor lists backends and devices)")
    elif kind not in {alias.partition(":")[0] for alias in there}:
        if backend.capabilities.name != "numba":
            ways.insert(0, "use --backend numba, which is faster on a CPU")
        ways.append(f"install the driver for {kind} devices (labbook doctor shows the devices found)")
    return Unsupported("--device", f"{reason}; {', or '.join(ways)}")
