"""A backend of another package."""

from labbook_toy import Backend


class Hourglass(Backend):
    """The toy under a name of its own."""

    NAME = "hourglass"
