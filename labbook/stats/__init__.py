"""Statistics of measurements: pooled replicates, errors within a run, trends, equivalence, model choice."""

from labbook.stats.measured import Measured
from labbook.stats.pooling import Pooled, pool
from labbook.stats.stopping import Decision, StoppingRule
from labbook.stats.tolerance import Tolerance

__all__ = ["Decision", "Measured", "Pooled", "StoppingRule", "Tolerance", "pool"]
