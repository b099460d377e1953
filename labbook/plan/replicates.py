"""How many replicates a point needs: as many as stated, and more until its pooled flow rate is precise
enough."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from labbook.stats import StoppingRule

if TYPE_CHECKING:
    from labbook.catalogue.catalogue import Catalogue
    from labbook.study import Study

QUANTITY = "flow_rate"


def stopping_rule(study: "Study") -> StoppingRule:
    """The rule by which replicates are added to a point of `study`."""
    tolerance, least = study.accuracy.flow_rate, study.replicates
    cap = least if tolerance is None else max(least, study.accuracy.max_replicates)
    return StoppingRule(tolerance=tolerance, minimum=least, cap=cap)


def flow_rates(study: "Study", catalogue: "Catalogue", run_keys: Sequence[str]) -> list[float]:
    """Flow rates [kg/s] of these runs, in their order, without those that gave none (clogged, diverged)."""
    from labbook.measure import MEASURES

    found = catalogue.values(run_keys, QUANTITY, MEASURES[QUANTITY].version, study.window)
    return [found[key] for key in run_keys if key in found]
