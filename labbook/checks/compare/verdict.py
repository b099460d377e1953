"""Result of a comparison: one JSON file in the lab for a study and two backends, the source of tables and figure."""

from pathlib import Path
from typing import Literal, Self

from pydantic import ValidationError

from labbook.backend.numerics import Precision
from labbook.lab.folder import LabFolder, write_bytes
from labbook.lab.records import StoredBackend, StoredModel

Finding = Literal["equivalent", "different", "undecided", "untested"]
"""`equivalent`: shown to lie within the margin. `different`: its whole interval lies beyond it. `undecided`: neither.
`untested`: there are not enough numbers; the note says why."""


class NoVerdict(Exception):
    """There is no verdict, or it cannot be read; the message says what to do."""


class Entrant(StoredModel):
    """A backend as it was compared. `precision`: precision of its runs; None: that of the study."""

    name: str
    cache_version: int
    device: str
    precision: Precision | None = None

    @property
    def called(self) -> str:
        """Name of the side: the backend's, with the precision if that differs from the study's."""
        return called(self.name, self.precision)


class Contrast(StoredModel):
    """Equivalence test of one quantity at one point.

    Differences are second backend less first, as a part of the first one's mean.
    """

    quantity: str
    unit: str
    paired: bool
    """True if both backends started from the same packings, so that numbers of one seed belong together."""
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
    """Probability of a finding of equivalence if there is no difference, with the measured scatter."""
    replicates_needed: int | None = None
    """Replicates for a power of 90 %."""


class Divergence(StoredModel):
    """Difference of positions from one packing [d], over the grains that both backends still have, against time [s]."""

    key: str
    seed: int
    time: tuple[float, ...]
    median: tuple[float, ...]
    largest: tuple[float, ...]
    agree_until: float
    """Last frame before the largest difference first exceeds 1e-3 d [s]."""
    ended: Literal["diverged", "longest", "empty", "failed"]
    """`longest`: the difference was still below a diameter at the end of the comparison."""
    note: str = ""
    rates: tuple[float | None, float | None]
    """Grain-steps per second of each backend, alone with this scene."""


class Cost(StoredModel):
    """Cost of the runs and packings of one backend."""

    backend: StoredBackend
    devices: tuple[str, ...]
    """Devices of its runs; runs that were in the lab before may come from another device than the requested one."""
    runs: int
    wall_time: float
    """Time spent stepping in all runs [s]; each member of an ensemble counts the whole time of the ensemble."""
    rate: float | None
    """Median over runs of grain-steps per second of that time."""
    session_wall: float | None = None
    """From start to end of the last session that ran anything for this comparison [s]."""
    session_rate: float | None = None
    """Grain-steps per second of that session, all runs together."""


class PointVerdict(StoredModel):
    """One point of the study. `runs`: keys of both backends' runs, from the first one's packings, by seed."""

    index: int
    label: str
    runs: tuple[tuple[str, ...], tuple[str, ...]]
    contrasts: tuple[Contrast, ...]
    divergence: Divergence | None


class Verdict(StoredModel):
    """Comparison of two backends on a study. `made`: UTC, ISO 8601; `measures`: versions of the measures used."""

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
        """`different` if one test is; `equivalent` if all are.

        If all tests have to pass, no correction for their number is due (intersection-union test).
        """
        findings = {contrast.finding for point in self.points for contrast in point.contrasts}
        if "different" in findings:
            return "different"
        return "equivalent" if findings == {"equivalent"} else "undecided"

    def write(self, path: Path) -> None:
        """Write the file in one piece."""
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, self.as_stored())

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a verdict from its file. Raises NoVerdict if it is missing or unreadable."""
        try:
            return cls.model_validate_json(path.read_bytes())
        except FileNotFoundError:
            raise NoVerdict(f"{path} does not exist: these backends were not compared on this study yet") from None
        except (OSError, ValidationError) as error:
            raise NoVerdict(f"{path} cannot be read ({type(error).__name__}): compare the backends again") from error


def path_of(lab: LabFolder, study: str, first: str, second: str) -> Path:
    """Return the file of the verdict on a study; `first`, `second`: names of the sides."""
    return lab.folder / "compare" / study / f"{first}-{second}.json"


def called(backend: str, precision: Precision | None) -> str:
    """Return the name of a side: the backend's, with the precision if that differs from the study's."""
    return f"{backend}-{precision}" if precision else backend
