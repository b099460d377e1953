"""A device takes no more runs at once than it has memory for."""

from dataclasses import replace

import labbook_toy
import pytest
from toy_lab import arrays, carry_out, study, study_file

from labbook.run.watch import Unwatched
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
            backend.most = max(backend.most, len(ensemble.glasses))
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


class Small(Device):
    """Its memory is taken by another program once there are members: an allocation fails whenever more than two of them
    take a beat, after the first few beats."""

    def __init__(self):
        super().__init__(None)
        self.refused = 0

    def open(self, spec, slots=None, device="cpu"):
        ensemble, backend, taken = super().open(spec, slots, device), self, 0
        advance = ensemble.advance

        def tight(beats=1):
            nonlocal taken
            taken += 1
            if len(ensemble.glasses) > 2 and taken > 2:
                backend.refused += 1
                raise MemoryError(f"cuda:0 has no memory for {len(ensemble.glasses)} members: none; use fewer grains")
            return advance(beats)

        ensemble.advance = tight
        return ensemble


def test_runs_for_which_memory_runs_out_later_go_on_with_fewer_at_once(tmp_path):
    told, alone = list[str](), tmp_path / "alone"

    class Told(Unwatched):
        def tell(self, line: str) -> None:
            told.append(line)

    backend = Small()
    asked = study(tmp_path, replicates=4)
    summary = carry_out(asked, tmp_path / "lab", backend=backend, device="cuda:0", watcher=Told(), checkpoint_every=0)
    assert backend.refused
    assert summary.failed == ()
    assert len(summary.tally.ran) == 8
    words = [line for line in told if "has no memory" in line]
    assert len(words) == backend.refused
    assert all(len(line.splitlines()) == 1 and "at once" in line and "--device cuda:all" in line for line in words)
    carry_out(asked, alone)
    for kind in ("runs", "packings"):
        for folder in sorted((alone / kind).iterdir()):
            assert arrays(tmp_path / "lab" / kind / folder.name) == arrays(folder)


def test_one_run_that_memory_has_no_room_for_fails_by_itself(tmp_path, monkeypatch):
    def none(*_):
        raise MemoryError("cuda:0 has no memory for 1 members: none; use fewer grains")

    monkeypatch.setattr(labbook_toy.Ensemble, "advance", none)
    summary = carry_out(study(tmp_path, orifices="[24]"), tmp_path / "lab", backend=Device(None), device="cuda:0")
    assert len(summary.failed) == 2
    assert all("use fewer grains" in why for why in summary.failed)
