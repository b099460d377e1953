"""A backend of another package."""

from dataclasses import replace

from labbook_toy import Backend


class Hourglass(Backend):
    """The toy under a name of its own, which knows the wall of its package."""

    NAME = "hourglass"

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.capabilities = replace(self.capabilities, walls=self.capabilities.walls | {"ball"})
