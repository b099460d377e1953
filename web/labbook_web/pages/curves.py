"""Curves W(t) for the charts, and the captions that explain them."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from labbook.measure.flow import Trace
from labbook.stats import Measured

_WINDOW = "the window in which the flow counts as steady"


def curve(trace: Trace, flow: Measured | None, label: str, why: str = "", **extra: Any) -> dict[str, Any]:
    """Data of a curve for the charts.

    Args:
        trace: Flow rate against time [kg/s, s].
        flow: Mean flow rate [kg/s]; None if it was not measured.
        label: Label of the curve.
        why: Reason for the missing mean, if `flow` is None.
        extra: Further data of the curve.

    Returns:
        The curve, its window [s] and the mean over it with its error [kg/s]; None in place of missing ones.
    """
    measured = flow is not None and math.isfinite(flow.value)
    return {
        "label": label,
        "time": trace.time,
        "rate": trace.rate,
        "window": [float(end) for end in trace.window] if trace.window is not None else None,
        "mean": [flow.value, flow.error] if flow is not None and measured else None,
        "why": "" if measured else flow.note if flow is not None else why,
        **extra,
    }


def caption(curves: Sequence[Mapping[str, Any]]) -> str:
    """Caption for the window and the means of a chart. Only a single curve has its window shaded."""
    means = sum(curve["mean"] is not None and curve["window"] is not None for curve in curves)
    why = next((curve["why"] for curve in curves if curve["why"]), "")
    if len(curves) == 1:
        if curves[0]["window"] is None:
            return f"No window and no mean: {why}." if why else ""
        return f"Shaded: {_WINDOW}; dotted: the mean over it." if means else f"Shaded: {_WINDOW}."
    count = f", of {means} of {len(curves)} runs" if means < len(curves) else ""
    sentence = f"Dotted: the mean over {_WINDOW}{count}." if means else f"No mean: {why}." if why else ""
    return f"{sentence} Hover over a curve to see its name.".strip()
