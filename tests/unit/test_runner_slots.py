"""A device takes no more runs at once than it has memory for."""

from dataclasses import replace

import labbook_toy
import pytest
from toy_lab import carry_out, study, study_file

from labbook.study import load


class Device(labbook_toy.Backend):
    """The toy backend on a device of its own, whose memory holds `holds` members of 200 grains."""

    def __init__(self, holds):
        super().__init__()
        self.capabilities = replace(self.capabilities, devices=("cpu", "cuda:0"))
        self.holds, self.most = holds, 0

    def capacity(self, spec, scene, device):
        assert device == "cuda:0"
        return self.holds and self.holds * 200 // scene.grains.count

    def open(self, spec, slots=None, device="cpu"):
        ensemble, backend = super().open(spec, slots, "cpu"), self
        admit = ensemble.admit

        def counted(*given, **options):
            member = admit(*given, **options)
            backend.most = max(backend.most, len(ensemble._glasses))
            return member

        ensemble.admit = counted
        return ensemble


@pytest.mark.parametrize(("holds", "most"), [(1, 1), (3, 3), (None, 4)])
def test_as_many_runs_at_once_as_fit(tmp_path, holds, most):
    backend = Device(holds)
    summary = carry_out(study(tmp_path), tmp_path / "lab", backend=backend, device="cuda:0")
    assert len(summary.tally.ran) == 4
    assert backend.most == most


def test_the_point_that_needs_most_decides(tmp_path):
    path = study_file(tmp_path, orifices="[24]", replicates=3)
    path.write_text(path.read_text().replace("sweep:\n", 'sweep:\n  grains.count: "[100, 200]"\n'))
    backend = Device(2)
    summary = carry_out(load(path), tmp_path / "lab", backend=backend, device="cuda:0")
    assert len(summary.tally.ran) == 6
    assert backend.most == 2, "four of 100 grains would fit, but one of 200 may come next"


def test_runs_that_are_recorded_go_on_beside_those_that_are_not(tmp_path):
    backend = Device(None)
    asked = study(tmp_path, "record: {every: 4 ms, replicates: 1}", orifices="[24]", replicates=4)
    summary = carry_out(asked, tmp_path / "lab", backend=backend, device="cuda:0")
    assert len(summary.tally.ran) == 4
    assert backend.most == 4, "two waves, where one takes them all"
    assert len([*(tmp_path / "lab").rglob("recording.npz")]) == 1
