"""W and profiles along the outlet of one run, for several starts of the window.

A window is an evaluation: no run is needed for another start. All starts are evaluated together, when a result first
needs them, and are stored in one file beside the run.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.measure.data import RunData
from labbook.measure.flow import FlowRate
from labbook.measure.measure import Evaluation, Measure, Window, after_start_up, as_arrays, from_arrays
from labbook.measure.outlet import OutletProfile, OutletProfiles, outlet_profile
from labbook.measure.series import mean_mass
from labbook.measure.steady import outflow
from labbook.scene import Scene

STARTS = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2)
"""Discharged fractions at which windows open, beside that of the study and the end of the start-up."""


@dataclass(frozen=True)
class ShiftedWindow:
    """A window of a study with another start.

    Attributes:
        start: Discharged fraction at its begin.
        end: Discharged fraction at its end.
        gap: Longest time without a grain that counts as flow [s]; None: the default of `scales.gap`.
        auto: True if it opens at the end of the start-up.
        timed: False: `start` and `end` are fractions.
    """

    start: float
    end: float
    gap: float | None = None
    auto: bool = False
    timed: bool = False


def shifted_windows(window: Window) -> tuple[ShiftedWindow, ...]:
    """List the windows to evaluate: those of STARTS, that of the study, and one from the end of the start-up."""
    own = () if after_start_up(window) else (window.start,)
    gap = getattr(window, "gap", None)
    starts = sorted({start for start in (*STARTS, *own) if start < window.end})
    return (
        *(ShiftedWindow(start, window.end, gap) for start in starts),
        ShiftedWindow(0.0, window.end, gap, auto=True),
    )


@dataclass(frozen=True, eq=False)
class StartResult:
    """Results of one run with another start of the window.

    Attributes:
        window: The window.
        flow_rate: W [kg/s]; NaN for too few grains.
        fraction: Fraction of the mass discharged as the window opens.
        plateau: False if the start-up takes too long to be left out.
        profile: Profiles along the outlet; None if they were not recorded.
    """

    window: ShiftedWindow
    flow_rate: float
    fraction: float
    plateau: bool
    profile: OutletProfile | None


class WindowStarts(Measure):
    """Measure W, and profiles along the outlet where they were recorded, for the windows of `shifted_windows`.

    Arrays:
        flow_rate: W for each of w windows [kg/s], shape [w]; NaN for too few grains.
        fraction: Discharged fraction at the begin of each, shape [w].
        plateau: False where the start-up takes too long to be left out, shape [w].
        NUMBER.*: Those of `OutletProfile` for the window of this number.

    Raises:
        MeasureError: The container has no outlet.
    """

    name = "window_starts"
    version = FlowRate.version + OutletProfiles.version  # it rises with either
    declared = ()

    def check(self, scene: Scene) -> None:
        FlowRate().check(scene)

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        return ()

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        windows = shifted_windows(window)
        flows = [outflow(run, opening)[0] for opening in windows]
        arrays: dict[str, np.ndarray] = {
            "flow_rate": np.array([np.nan if flow is None else mean_mass(run) * flow.rate for flow in flows]),
            "fraction": np.array([np.nan if flow is None else flow.fraction[0] for flow in flows]),
            "plateau": np.array([flow is not None and flow.plateau for flow in flows]),
        }
        for index, opening in enumerate(windows if "slab" in run.tables else ()):
            if (profile := outlet_profile(run, opening)) is not None:
                arrays |= {f"{index}.{name}": values for name, values in as_arrays(profile).items()}
        return Evaluation(arrays=arrays)

    @staticmethod
    def of(evaluation: Evaluation, window: Window) -> Iterator[StartResult]:
        """Read the results of `evaluate` for a window of the study."""
        arrays = evaluation.arrays
        for index, opening in enumerate(shifted_windows(window)):
            profile = from_arrays(OutletProfile, _starting(f"{index}.", arrays))
            rate, fraction = float(arrays["flow_rate"][index]), float(arrays["fraction"][index])
            yield StartResult(opening, rate, fraction, bool(arrays["plateau"][index]), profile)


def _starting(prefix: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}
