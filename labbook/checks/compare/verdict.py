"""What came of a comparison: one JSON file in the lab for a study and two backends, which tables and figure show."""

from pathlib import Path
from typing import Literal, Self

from pydantic import ValidationError

from labbook.backend.numerics import Precision
from labbook.lab.folder import LabFolder, write_bytes
from labbook.lab.records import Part, StoredBackend

Finding = Literal["equivalent", "different", "undecided", "untested"]
"""`equivalent`: shown to lie within the margin. `different`: its whole interval lies beyond it. `undecided`: neither.
`untested`: there are not enough numbers; the note says why."""


class NoVerdict(Exception):
    """There is no verdict, or it cannot be read; the message says what to do."""


class Entrant(Part):
    """A backend as it was compared. `precision`: the one that it was compared in; None: that of the study."""

    name: str
    cache_version: int
    device: str
    precision: Precision | None = None

    @property
    def called(self) -> str:
        """Its name, with its precision where that is not the study's."""
        return called(self.name, self.precision)


class Contrast(Part):
    """An equivalence test of one quantity at one point; differences are second backend less first, as a part of the
    first one's mean."""

    quantity: str
    unit: str
    paired: bool
    """Whether both backends started from the same packings, and numbers of one seed belong together."""
    seeds: tuple[int, ...]
    first: tuple[float, ...]
    second: tuple[float, ...]
    finding: Finding
    note: str = ""
    difference: float | None = None
    error: float | None = None
    low: float | None = None
    high: float | None = None
    """Ends of the interval at confidence 1 - 2 alpha."""
    p: float | None = None
    power: float | None = None
    """Probability to show equivalence if there is no difference, with the scatter as measured."""
    replicates_needed: int | None = None
    """For a power of 90 %."""


class Divergence(Part):
    """Difference of positions from one packing [d], over the grains that both backends still have, against time [s]."""

    key: str
    seed: int
    time: tuple[float, ...]
    median: tuple[float, ...]
    largest: tuple[float, ...]
    agree_until: float
    """Last frame before the largest difference first exceeds 1e-3 d [s]."""
    ended: Literal["diverged", "longest", "empty", "failed"]
    """`longest`: still not apart by a diameter when looking ended."""
    note: str = ""
    rates: tuple[float | None, float | None]
    """Grain-steps per second of each backend, alone with this scene."""


class Cost(Part):
    """What the runs and packings of one backend took."""

    backend: StoredBackend
    devices: tuple[str, ...]
    """On which its runs were made; runs that were there already may come from another device than asked for."""
    runs: int
    wall_time: float
    """Spent stepping in all runs [s]; members that step together each count the whole of it."""
    rate: float | None
    """Median over runs of grain-steps per second of that time."""
    session_wall: float | None = None
    """From start to end of the last session that ran anything for this comparison [s]."""
    session_rate: float | None = None
    """Grain-steps per second of that session, all runs together."""


class PointVerdict(Part):
    """One point of the study. `runs`: keys of both backends' runs, from the first one's packings, by seed."""

    index: int
    label: str
    runs: tuple[tuple[str, ...], tuple[str, ...]]
    contrasts: tuple[Contrast, ...]
    divergence: Divergence | None


class Verdict(Part):
    """A comparison of two backends on a study. `made`: UTC, ISO 8601; `measures`: versions of what it rests on."""

    format: Literal[1] = 1
    study: str
    made: str
    entrants: tuple[Entrant, Entrant]
    measures: dict[str, int]
    margin: float
    alpha: float
    replicates: int
    points: tuple[PointVerdict, ...]
    costs: tuple[Cost, Cost]

    @property
    def finding(self) -> Finding:
        """`different` if one test is; `equivalent` if all are (no correction is due where all have to pass)."""
        found = {one.finding for point in self.points for one in point.contrasts}
        if "different" in found:
            return "different"
        return "equivalent" if found == {"equivalent"} else "undecided"

    def write(self, path: Path) -> None:
        """Write the file, as a whole."""
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, self.as_stored())

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read what `write` wrote. Raises NoVerdict."""
        try:
            return cls.model_validate_json(path.read_bytes())
        except FileNotFoundError:
            raise NoVerdict(f"{path} does not exist: these backends were not compared on this study yet") from None
        except (OSError, ValidationError) as error:
            raise NoVerdict(f"{path} cannot be read ({type(error).__name__}): compare the backends again") from error


def path_of(lab: LabFolder, study: str, first: str, second: str) -> Path:
    """Where the verdict on a study is kept; `first`, `second`: what the sides are called."""
    return lab.folder / "compare" / study / f"{first}-{second}.json"


def called(backend: str, precision: Precision | None) -> str:
    """What a side is called: its backend's name, with its precision where that is not the study's."""
    return f"{backend}-{precision}" if precision else backend
