"""The section on arches, from a bed of five grains of which three span the outlet."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection, LineCollection

from labbook.checks.verify.materials import D, G, hertz, scene
from labbook.measure.arch import StoppedBed
from labbook.report.arch import arch_table
from labbook.report.figures import arch_figure
from labbook.results.arch import PointArches, arches
from labbook.scene import WedgeHopper
from labbook.stats import Pooled

X = np.array([[-1.4, 0, 0.5], [0, 0, 1.0], [1.4, 0, 0.5], [0.3, 0, 1.9], [9, 0, 9]]) * D
BED = StoppedBed(
    ids=np.array([3, 1, 4, 0, 7]), x=X, pairs=np.array([[0, 1], [1, 2], [1, 3]]), force=np.array([4.0, 2.0, 1.0]),
    rows=np.array([0, 1, 2]), link=np.array([4.0, 2.0]), links=np.array([[0, 1], [1, 2]]),
)  # fmt: skip


class Drawn(PointArches):
    """Arches whose last bed is BED."""

    @property
    def last(self) -> StoppedBed:
        return BED


def point(width: float, sizes: list[list[float]]) -> Drawn:
    hopper = WedgeHopper(width=0.06, height=0.2, thickness=1.01 * D, orifice=width * D)
    arrays = [SimpleNamespace(arrays={"size": np.array(own)}) for own in sizes]
    runs = tuple(SimpleNamespace(counted=True, measures=("arch",), evaluation=lambda _, own=own: own) for own in arrays)
    means = {"arch_grains": Pooled(6.5, 0.25, 1.0, 2), "arch_force": Pooled(20.0, 2.0, 8.0, 2)}
    of = SimpleNamespace(scene=scene(5, hertz(), hopper, G))
    return Drawn(cast(Any, SimpleNamespace(point=of, label=f"D {width:g}", pooled=means, runs=runs)), cast(Any, runs))


def test_points_with_arches_are_in_the_order_of_their_outlets():
    wide, narrow = point(3.0, [[7.0]]), point(2.5, [[5.0, 6.0], [7.0]])
    none = SimpleNamespace(runs=(SimpleNamespace(counted=True, measures=()),), pooled={})
    found = arches(cast(Any, [wide.result, none, narrow.result]))
    assert [one.width_ratio for one in found] == pytest.approx([2.5, 3.0])
    assert found[0].sizes.tolist() == [5, 6, 7]
    rows = arch_table(found).rows
    assert rows[0] == ("D 2.5", "2.5", "3", "2", "6.5 ± 0.2", "5 to 7", "20 ± 2")


def test_the_picture_marks_the_arch_and_shows_forces_by_width():
    """Of the five grains one is too far away to be drawn."""
    figure = arch_figure([point(2.5, [[3.0]]), point(3.0, [[3.0, 4.0]])])
    bed, _, sizes = figure.axes
    grains, arch = (one for one in bed.collections if isinstance(one, EllipseCollection))
    assert (len(np.asarray(grains.get_offsets())), len(np.asarray(arch.get_offsets()))) == (4, 3)
    assert np.asarray(arch.get_offsets()) == pytest.approx(X[:3, [0, 2]] * 1e3)
    forces, along = (one for one in bed.collections if isinstance(one, LineCollection))
    assert np.asarray(forces.get_linewidth()) == pytest.approx([3.0, 1.5, 0.75])
    assert np.asarray(along.get_linewidth()) == pytest.approx([3.0, 1.5])
    assert sizes.get_xlabel() == "$D/d$"
