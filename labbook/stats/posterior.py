"""Posterior of a few parameters, each from 0 to 1 with a uniform prior.

Up to four parameters it is computed on a grid, which is narrowed to the bulk of the posterior. With more it is sampled
by emcee (Foreman-Mackey et al., Publ. Astron. Soc. Pac. 125 (2013) 306).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labbook.stats.emulator import LearnMissing

LogLikelihood = Callable[[np.ndarray], np.ndarray]
"""Function that gives ln of the likelihood, up to a constant, at k sets of parameters: shape [k, p] to [k]."""
GRID = 4
"""Largest number of parameters of a grid."""
_CELLS = {1: 801, 2: 71, 3: 23, 4: 11}
"""Cells of a grid along each parameter, by the number of parameters."""
_PASSES = 4
_NEGLIGIBLE = 1e-5
"""Density, over the largest one, below which the grid is cut off."""
_WALKERS, _STEPS, _BURN = 64, 1500, 500


@dataclass(frozen=True, eq=False)
class Posterior:
    """Sets of parameters with their weights.

    Attributes:
        parameter_sets: Sets of parameters, shape [k, p].
        weights: Weights, shape [k]; their sum is 1.
        density: Density of the posterior, up to a constant, shape [k].
        cell: Extent of the grid cell about each set, shape [p]; 0 for samples.
    """

    parameter_sets: np.ndarray
    weights: np.ndarray
    density: np.ndarray
    cell: np.ndarray

    @cached_property
    def mean(self) -> np.ndarray:
        """Mean, shape [p]."""
        return self.weights @ self.parameter_sets

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance, shape [p, p]."""
        off = self.parameter_sets - self.mean
        # the variance of a uniform distribution over the cell comes on top of that between cells
        return (off * self.weights[:, None]).T @ off + np.diag(self.cell**2 / 12)

    def quantiles(self, probabilities: np.ndarray) -> np.ndarray:
        """Compute quantiles of each parameter, for m probabilities: shape [m, p]."""
        columns = []
        for index, width in enumerate(self.cell):
            values, inverse = np.unique(self.parameter_sets[:, index], return_inverse=True)
            mass = np.bincount(inverse, self.weights)
            if width:
                edges = np.concatenate([values - width / 2, [values[-1] + width / 2]])
                columns.append(np.interp(probabilities, np.concatenate([[0.0], np.cumsum(mass)]), edges))
            else:
                columns.append(np.interp(probabilities, np.cumsum(mass) - mass / 2, values))
        return np.array(columns).T

    def samples(self, number: int, rng: np.random.Generator) -> np.ndarray:
        """Draw sets of parameters, shape [number, p]."""
        index = rng.choice(len(self.weights), number, p=self.weights)
        return np.clip(self.parameter_sets[index] + self.cell * rng.uniform(-0.5, 0.5, (number, len(self.cell))), 0, 1)

    def region(self, probability: float) -> np.ndarray:
        """Mark the places in the region of highest density that holds this part of the posterior, shape [k]."""
        return self.density >= self.threshold(probability)

    def threshold(self, probability: float) -> float:
        """Compute the density at the edge of that region of highest density."""
        order = np.argsort(self.density)[::-1]
        last = int(np.searchsorted(np.cumsum(self.weights[order]), probability))
        return float(self.density[order[min(last, len(order) - 1)]])


def posterior(log_likelihood: LogLikelihood, parameters: int) -> Posterior:
    """Compute the posterior of a number of parameters.

    Args:
        log_likelihood: ln of the likelihood.
        parameters: Number of parameters.

    Raises:
        LearnMissing: emcee is needed but not installed.
    """
    return _on_grid(log_likelihood, parameters) if parameters <= GRID else _sampled(log_likelihood, parameters)


def _on_grid(log_likelihood: LogLikelihood, p: int) -> Posterior:
    low, high, n = np.zeros(p), np.ones(p), _CELLS[p]
    for number in range(_PASSES):
        cell = (high - low) / n
        axes = [start + width * (np.arange(n) + 0.5) for start, width in zip(low, cell, strict=True)]
        parameter_sets = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
        logs = log_likelihood(parameter_sets)
        density = np.exp(logs - logs.max())
        there = parameter_sets[density > _NEGLIGIBLE]
        inner = np.maximum(there.min(axis=0) - cell, 0), np.minimum(there.max(axis=0) + cell, 1)
        narrower = ((inner[1] - inner[0]) < 0.7 * (high - low)).any()
        if number == _PASSES - 1 or not narrower:
            break
        low, high = inner
    return Posterior(parameter_sets, density / density.sum(), density, cell)


def _sampled(log_likelihood: LogLikelihood, p: int) -> Posterior:
    try:
        import emcee
    except ImportError as missing:
        raise LearnMissing("emcee") from missing

    def inside(parameter_sets: np.ndarray) -> np.ndarray:
        logs = log_likelihood(np.clip(parameter_sets, 0, 1))
        return np.where(((parameter_sets >= 0) & (parameter_sets <= 1)).all(axis=1), logs, -np.inf)

    walkers = max(_WALKERS, 4 * p)
    rng = np.random.RandomState(1)  # emcee takes no Generator
    # walkers start at the best of many random places: those in a lobe of negligible density would stay there
    trial = rng.uniform(size=(64 * walkers, p))
    start = trial[np.argsort(inside(trial))[-walkers:]]
    sampler = emcee.EnsembleSampler(walkers, p, inside, vectorize=True)
    state = emcee.State(start, random_state=rng.get_state())
    sampler.run_mcmc(state, _BURN + _STEPS, skip_initial_state_check=True)
    parameter_sets = np.clip(np.asarray(sampler.get_chain(discard=_BURN, flat=True, thin=10)), 0, 1)
    logs = np.asarray(sampler.get_log_prob(discard=_BURN, flat=True, thin=10))
    return Posterior(
        parameter_sets, np.full(len(parameter_sets), 1 / len(parameter_sets)), np.exp(logs - logs.max()), np.zeros(p)
    )
