"""Several devices of one machine on one study: a process each, with the same bits as one, whatever becomes of them."""

import json
import os
import signal
import sys
import time

import pytest
from labbook_toy import Backend
from toy_lab import arrays, labbook, start, study_file

from labbook.backend import Unsupported
from labbook.lab import LabFolder, studies
from labbook.lab.runs import RunRecord
from labbook.plan.devices import parse_devices
from labbook.run.devices import merged_view
from labbook.run.watch import ActiveJob, View

DEVICES = "cpu,toy:0,toy:1"
GIVEN = ("--backend", "toy", "--device", "toy:0,toy:1")


def files(lab):
    """The bits of all runs and packings of a lab."""
    return {f"{kind}/{one.name}": arrays(one) for kind in ("runs", "packings") for one in (lab / kind).iterdir()}


def made_on(lab):
    """Devices by run key."""
    return {one.name: RunRecord.read(one).device for one in (lab / "runs").iterdir()}


def test_devices_are_named_by_lists_and_by_kind(monkeypatch):
    monkeypatch.setenv("LABBOOK_TOY_DEVICES", DEVICES)
    toy = Backend()
    assert parse_devices("cpu", toy) == ("cpu",)
    assert parse_devices("toy:1, toy:0", toy) == ("toy:1", "toy:0")
    assert parse_devices("toy:all,cpu", toy) == ("toy:0", "toy:1", "cpu")
    with pytest.raises(Unsupported, match="toy has no cuda:all here; it has cpu, toy:0, toy:1; use --device toy:0, or"):
        parse_devices("cuda:all", toy)
    with pytest.raises(Unsupported, match="toy:0 is named twice"):
        parse_devices("toy:all,toy:0", toy)


def test_progress_of_devices_is_added_up():
    one = View(1, 4, 1, (ActiveJob("a", "settling", ("x",)),), 3, 10.0, 30.0, 2.0)
    other = View(2, 5, 0, (ActiveJob("b", "discharging", ("y",)),), 2, 5.0, 15.0, 1.0, True)
    total = merged_view([("toy:0", one), ("toy:1", other)])
    assert (total.runs_done, total.runs_asked, total.fillings_left, total.elsewhere) == (3, 9, 1, 0)
    assert [going.label for going in total.going] == ["toy:0: a", "toy:1: b"]
    assert (total.work_done, total.work_left, total.rate, total.open_ended) == (15.0, 45.0, 3.0, True)


@pytest.mark.slow
def test_two_devices_make_the_same_bits_as_one_process_and_share_the_work(tmp_path, monkeypatch):
    path = study_file(tmp_path, replicates=6, orifices="[18, 21, 24]")
    labbook("run", path, "--lab", tmp_path / "one", "--backend", "toy")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    ended = labbook("run", path, "--lab", tmp_path / "two", *GIVEN, LABBOOK_TOY_DEVICES=DEVICES)
    assert "18 of 18 runs done" in ended.stdout
    assert "6 packings" in ended.stdout
    assert files(tmp_path / "two") == files(tmp_path / "one")
    devices = list(made_on(tmp_path / "two").values())
    assert {name: devices.count(name) for name in set(devices)} == {"toy:0": 9, "toy:1": 9}
    assert list(studies.candidates(LabFolder(tmp_path / "two"))) == ["toy-study"]
    again = labbook("run", path, "--lab", tmp_path / "two", *GIVEN, LABBOOK_TOY_DEVICES=DEVICES)
    assert "18 of 18 runs done" in again.stdout
    assert "now:" not in again.stdout


@pytest.mark.slow
def test_a_device_that_breaks_leaves_its_work_to_the_other(tmp_path, monkeypatch):
    path = study_file(tmp_path, replicates=4)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    given = {"LABBOOK_TOY_DEVICES": DEVICES, "LABBOOK_TOY_BREAKS": "toy:1"}
    ended = labbook("run", path, "--lab", tmp_path / "lab", *GIVEN, check=False, **given)
    assert "8 of 8 runs done" in ended.stdout
    assert "Failed: toy:1: its process ended with exit status 7" in ended.stdout
    assert ended.exit_code == 1
    assert set(made_on(tmp_path / "lab").values()) == {"toy:0"}


@pytest.mark.slow
def test_replicates_that_are_added_go_to_whoever_is_free(tmp_path, monkeypatch):
    path = study_file(tmp_path, "accuracy: {flow_rate: 2 %, max_replicates: 7}", replicates=2)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    labbook("run", path, "--lab", tmp_path / "one", "--backend", "toy", "--no-pilot")
    labbook("run", path, "--lab", tmp_path / "two", *GIVEN, "--no-pilot", LABBOOK_TOY_DEVICES=DEVICES)
    assert files(tmp_path / "two") == files(tmp_path / "one")
    assert len(made_on(tmp_path / "two")) > 4, "replicates were added"


@pytest.mark.slow
@pytest.mark.parametrize(
    "sent", [*(pytest.param(one, marks=pytest.mark.ring) for one in (signal.SIGINT, signal.SIGTERM)), signal.SIGKILL]
)
def test_a_signal_to_the_first_process_ends_all_and_the_same_command_goes_on(sent, tmp_path):
    path, lab = study_file(tmp_path, replicates=2), tmp_path / "lab"
    words = ("run", path, "--lab", lab, *GIVEN, "--checkpoint-every", 0)
    process = start(*words, delay=0.05, LABBOOK_TOY_DEVICES=DEVICES)
    end = time.monotonic() + 60
    while len(list((lab / "work").glob("*/progress.json"))) < 2:
        assert time.monotonic() < end
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    process.send_signal(sent)
    process.communicate(timeout=60)
    assert process.returncode == {signal.SIGKILL: -9}.get(sent, 130)
    end = time.monotonic() + 30
    while any(
        LabFolder(lab).is_claimed(one.stem) for one in (lab / "work").glob("*.lock")
    ):  # by processes that have lost the first
        assert time.monotonic() < end
        time.sleep(0.05)
    out, _ = start(*words, LABBOOK_TOY_DEVICES=DEVICES).communicate(timeout=60)
    assert "4 of 4 runs done" in out
    assert "continued from a checkpoint" in out
    labbook("run", path, "--lab", tmp_path / "whole", "--backend", "toy")
    assert files(lab) == files(tmp_path / "whole")


def test_a_plan_on_two_devices_takes_half_the_time(tmp_path, monkeypatch):
    monkeypatch.setenv("LABBOOK_TOY_DEVICES", DEVICES)
    path = study_file(tmp_path, replicates=6)
    told = [
        json.loads(
            labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy", "--device", one, "--json").stdout
        )
        for one in ("toy:0", "toy:all")
    ]
    alone, both = (one["forecast"] for one in told)
    assert both["seconds"] == pytest.approx(alone["seconds"] / 2)
    assert (alone["lanes"], both["lanes"]) == (1, 2)
