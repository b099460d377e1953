"""How backends are found: by the entry points by which they announce themselves."""

from importlib.metadata import entry_points
from importlib.util import find_spec

from labbook.backend.contract import Backend


class BackendMissing(Exception):
    """No such backend, or it cannot be loaded; the message says why and what to do."""


GROUP = "labbook.backends"


def installed() -> dict[str, str]:
    """Names of the backends that announce themselves -> where they are; none is imported."""
    return {entry.name: entry.value for entry in entry_points(group=GROUP)}


def load(name: str) -> Backend:
    """The backend called `name`. Raises BackendMissing with the reason, also when it is there but broken.

    Backends import late what is heavy. The modules that they name in `requires` are looked for here, not imported.
    """
    for entry in entry_points(group=GROUP):
        if entry.name == name:
            try:
                backend = entry.load()()
            except ImportError as error:
                raise BackendMissing(
                    f"the backend {name} is there but cannot be loaded ({error}); try: pip install 'labbook[{name}]'"
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
