"""Questions to a surface that a page and Python answer alike."""

import math
from typing import Any

import numpy as np
import pytest

from labbook.results.explore import DesignSurface
from labbook.results.surface import NoSurface

ANSWERS = """
((view, designs, targets) => ({
  values: designs.map((one) => surfaces.predict(view, one)),
  inverses: targets.map(([target, key, at]) => surfaces.inverse(view, target, key, at)),
}))
"""
"""What a page answers about designs and wanted values, in JavaScript."""


def questions(surface: DesignSurface, rng: np.random.Generator) -> tuple[list[list[float]], list[list[Any]]]:
    """Random designs in and around the range, and wanted values with a key to change and values of the others."""
    low, high = (np.array([getattr(one, end) for one in surface.factors]) for end in ("low", "high"))
    designs = (low + (high - low) * rng.uniform(-0.05, 1.05, (60, len(low)))).tolist()
    values = [one.pooled[surface.quantity].value for one in surface.points]
    targets = [
        [float(rng.uniform(0.9 * min(values), 1.1 * max(values))), int(rng.integers(len(low))), one]
        for one in (low + (high - low) * rng.uniform(0, 1, (40, len(low)))).tolist()
    ]
    return designs, targets


def compare(surface: DesignSurface, answers: dict[str, Any], designs: list, targets: list) -> None:
    """Compare answers of JavaScript with those of Python: to the digits of floats for a surface; a curve is
    interpolated between 257 places, which costs less than 1e-4."""
    near = 1e-9 if surface.curve is None else 1e-4
    refused = 0
    for design, value in zip(designs, answers["values"], strict=True):
        at = dict(zip(surface.keys, design, strict=True))
        try:
            expected = surface.predict(at)
        except NoSurface:
            refused += 1
            assert value is None, at
        else:
            assert value == pytest.approx(expected, rel=near)
    assert 0 < refused < len(designs)
    found = 0
    for (target, key, at), answer in zip(targets, answers["inverses"], strict=True):
        rest = {name: x for k, (name, x) in enumerate(zip(surface.keys, at, strict=True)) if k != key}
        try:
            expected = surface.inverse(target, surface.keys[key], rest)
        except NoSurface:
            assert "value" not in answer, (target, rest, answer)
            continue
        found += 1
        ends = [answer["low"] if answer["low"] is not None else -math.inf,
                answer["high"] if answer["high"] is not None else math.inf]  # fmt: skip
        # Python interpolates the zero within 1/2048 of the range
        assert [answer["value"], *ends] == pytest.approx([expected.value, expected.low, expected.high], rel=2e-4)
    assert found > 3
