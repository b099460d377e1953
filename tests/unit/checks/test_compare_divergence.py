"""How long two backends that start from one packing agree."""

from itertools import pairwise

import numpy as np
import pytest
from labbook_toy import Ensemble, Twin
from toy_lab import carry_out
from toy_pair import compared, contestants, study

from labbook.backend.probes import Sample
from labbook.checks.compare.lockstep import AGREE, divergence, side_by_side
from labbook.checks.compare.sides import from_shared
from labbook.lab import LabFolder

# drifting apart


class Drifting(Twin):
    """Every grain is off by d 10^-9 exp(t/tau), a hundred times less but for the one with id 0."""

    TAU = 0.01

    def open(self, spec, slots=None, device="cpu"):
        return DriftingEnsemble(self, spec, slots)


class DriftingEnsemble(Ensemble):
    def drain(self):
        tables = {}
        for probe, table in super().drain().items():
            size = 3e-3 * 1e-9 * np.exp(table["time"] / Drifting.TAU) if isinstance(probe, Sample) else 0.0
            tables[probe] = {**table, "x": table["x"] + size * np.where(table["id"] == 0, 1.0, 0.01)}
        return tables


@pytest.mark.slow
def test_backends_agree_until_the_largest_difference_exceeds_a_thousandth(tmp_path):
    # an outlet that clogs at once: the grain 0 stays
    asked, lab = study(tmp_path, "stop: {stall: 0.5 s}", orifices="[5]"), tmp_path / "lab"
    carry_out(asked, lab)
    two = contestants(second=Drifting())
    first, second = (shared.run(1) for shared in from_shared(asked, asked.points[0], two))
    found = divergence(two, (first, second), LabFolder(lab), {})
    expected = Drifting.TAU * np.log(AGREE / 1e-9)
    frame = found.time[1]
    assert expected - frame < found.agree_until <= expected
    assert found.ended == "diverged"
    assert found.time[-1] == pytest.approx(Drifting.TAU * np.log(1e9), abs=frame)
    ratio = np.array(found.largest[1:]) / np.array(found.median[1:])
    np.testing.assert_allclose(ratio[-10:], 100, rtol=1e-6)
    growth = np.log(found.largest[-1] / found.largest[-11]) / (found.time[-1] - found.time[-11])
    assert growth == pytest.approx(1 / Drifting.TAU, rel=1e-6)


@pytest.mark.slow
def test_backends_that_never_part_agree_to_the_end(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    found = compared(asked, lab).points[0].divergence
    assert found is not None
    assert set(found.largest) == {0.0}
    assert found.agree_until == found.time[-1]
    assert found.ended in ("longest", "empty")


def test_frames_are_of_the_same_moments(tmp_path):
    asked, lab = study(tmp_path, replicates=1, orifices="[24]"), tmp_path / "lab"
    carry_out(asked, lab)
    two = contestants()
    run = from_shared(asked, asked.points[0], two)[0].run(1)
    frames = list(side_by_side(two, run, LabFolder(lab), 1e-3, 0.0105, ("x",)))
    assert frames[0].rates == (None, None), "backends may compile in their first beat"
    assert all(rate is not None and rate > 0 for frame in frames[1:] for rate in frame.rates)
    assert [frame.time for frame in frames] == pytest.approx(np.arange(1, 11) * 1e-3)
    for frame in frames:
        for table in frame.tables:
            assert set(np.round(table["time"], 12)) == {round(frame.time, 12)}
            assert all(a < b for a, b in pairwise(table["id"]))
