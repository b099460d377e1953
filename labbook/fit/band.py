"""Bands about fitted laws: where the law lies, and where one more point would."""

import math

import numpy as np

from labbook.stats.pooling import student


def law_error(slopes: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Standard error of a law at n places, shape [n], to first order.

    `slopes`: derivatives of the law by its p parameters, shape [n, p]; `covariance` of these, shape [p, p].
    """
    with np.errstate(invalid="ignore"):
        return np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes))


def scatter(errors: np.ndarray, residuals: np.ndarray, dof: int) -> float:
    """Standard error of one point about its law: that of the points, or their scatter if that is larger.

    `errors`: standard errors of the n fitted points; `residuals`: what they lie off the law; `dof`: n less parameters.
    """
    own = float(np.mean(np.square(errors)))
    return math.sqrt(max(own, float(np.sum(np.square(residuals))) / dof) if dof > 0 else own)


def half_width(law: np.ndarray, confidence: float, degrees_of_freedom: float, point: float = 0.0) -> np.ndarray:
    """Half of the interval of a law with standard errors `law`; with `point`, the standard error of a point about it,
    that of one more point: t sqrt(law^2 + point^2), Student's t (Draper & Smith, Applied Regression Analysis, 1998,
    section 3.1).
    """
    return student(confidence, degrees_of_freedom) * np.hypot(law, point)
