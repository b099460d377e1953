"""A part of a study's runs, for one of several processes or machines."""

import re
from dataclasses import dataclass

MOST = 100_000


@dataclass(frozen=True)
class Shard:
    """Part `number` of `of`, from 1 on. Seeds take turns, in every container another one first: runs that start from
    one packing are in one shard, always the same, whatever else a study asks for."""

    number: int
    of: int

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """From i/n. Raises ValueError."""
        found = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", text)
        number, of = map(int, found.groups()) if found else (0, 0)
        if not 1 <= number <= of <= MOST:
            raise ValueError(f"{text!r} is no part of a whole; write i/n with i from 1 to n, such as 1/4")
        return cls(number, of)

    def holds(self, closed: str, seed: int) -> bool:
        """Whether runs with this seed belong to it, in the container whose closed form has this key."""
        return (int(closed[:15], 16) + seed) % self.of == self.number - 1

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


WHOLE = Shard(1, 1)
"""All runs of a study."""
