"""Campaigns: results decide which runs come next. Propose, run, evaluate, propose.

A strategy proposes runs, generation by generation (`strategy.py`). `Campaign` requests proposals, stores them and knows
when it has ended (`campaign.py`). Making the runs is the task of other packages.
"""

import warnings
from typing import Any

from labbook.campaign.calibrate import Calibrate, Prior
from labbook.campaign.campaign import Campaign
from labbook.campaign.find import Find
from labbook.campaign.fit_law import FitLaw
from labbook.campaign.goal import Goal
from labbook.campaign.inference import Inference, Measurement, NotInferred
from labbook.campaign.mapping import Map
from labbook.campaign.precise import PreciseRun
from labbook.campaign.registry import STRATEGIES, Strategies
from labbook.campaign.replicates import Replicates
from labbook.campaign.stops import Stops
from labbook.campaign.strategy import (
    Assignment,
    Generation,
    History,
    Proposal,
    Strategy,
    Trial,
    point_key,
)
from labbook.campaign.transition import Transition
from labbook.warning import caller

__all__ = [
    "STRATEGIES",
    "Assignment",
    "Calibrate",
    "Campaign",
    "Find",
    "FitLaw",
    "Generation",
    "Goal",
    "History",
    "Inference",
    "Map",
    "Measurement",
    "NotInferred",
    "PreciseRun",
    "Prior",
    "Proposal",
    "Replicates",
    "Stops",
    "Strategies",
    "Strategy",
    "Transition",
    "Trial",
    "point_key",
]


def __getattr__(name: str) -> Any:
    if name == "place":  # former name
        warnings.warn_explicit("labbook.campaign.place is now called point_key", DeprecationWarning, *caller())
        return point_key
    raise AttributeError(f"module {__name__} has no attribute {name}")
