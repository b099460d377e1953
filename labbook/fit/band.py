"""Confidence bands about fitted laws, and prediction bands of one more point."""

import math

import numpy as np

from labbook.stats.pooling import student


def law_error(slopes: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Standard error of a law at n places, to first order (delta method).

    Args:
        slopes: Derivatives of the law by its p parameters, shape [n, p].
        covariance: Covariance of the parameters, shape [p, p].

    Returns:
        Standard errors, shape [n]; NaN where the covariance is infinite.
    """
    with np.errstate(invalid="ignore"):
        return np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes))


def scatter(errors: np.ndarray, residuals: np.ndarray, dof: int) -> float:
    """Standard error of one point about its law: the points' own error, or their scatter if that is larger.

    Args:
        errors: Standard errors of the n fitted points.
        residuals: Distances of the points from the law.
        dof: n less the number of parameters.
    """
    own = float(np.mean(np.square(errors)))
    return math.sqrt(max(own, float(np.sum(np.square(residuals))) / dof) if dof > 0 else own)


def half_width(law: np.ndarray, confidence: float, degrees_of_freedom: float, point: float = 0.0) -> np.ndarray:
    """Half width of the interval of a law, or of one more point: t sqrt(law^2 + point^2), with Student's t.

    Source: Draper & Smith, Applied Regression Analysis, 1998, section 3.1.

    Args:
        law: Standard errors of the law, shape [n].
        confidence: Confidence of the interval.
        degrees_of_freedom: Of Student's t.
        point: Standard error of a point about the law; 0: the interval of the law itself.
    """
    return student(confidence, degrees_of_freedom) * np.hypot(law, point)
