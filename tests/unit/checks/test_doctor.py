"""The doctor lets backends work, and reports one that is broken."""

import ast
import json
from dataclasses import replace

import labbook_toy
import pytest
from toy_lab import ROOT
from typer.testing import CliRunner

from labbook.backend import BackendMissing, Device, Survey, Unsupported, load
from labbook.checks import doctor
from labbook.cli import build
from labbook.scene import HertzMindlin, LinearSpringDashpot, Plane, Strip


@pytest.mark.compiles
def test_the_cpu_backend_bounces_a_grain():
    from labbook_numba import Backend

    backend = Backend(wide=True)  # whose kernels are those of the contract's tests
    assert doctor.bounce(backend, "cpu") == pytest.approx(doctor.TARGET, abs=2e-3)


@pytest.mark.parametrize(
    ("contact", "wall", "above"),
    [
        (HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25, restitution=0.5), None, None),
        (LinearSpringDashpot(normal_stiffness=1e5, restitution=0.5), Plane(point=(0, 0, 0.3), normal=(0, 0, 2)), 0.9),
        (LinearSpringDashpot(normal_stiffness=1e3, restitution=0.5), Strip(start=(-0.1, -0.2), end=(0.1, -0.2)), 0.0),
    ],
)
def test_a_grain_bounces_off_another_wall_by_another_law(contact, wall, above):
    place = {} if wall is None else {"wall": wall, "above": (0.01, 0.02, above)}
    restitution = doctor.bounce(load("reference"), "cpu", contact, **place)
    # the restitution asked for is exact but for the step, a 400th of the collision: 1e-3 of the damping
    assert restitution == pytest.approx(0.5, abs=2e-3)


def test_a_grain_that_would_miss_the_wall_is_told():
    plate = Strip(start=(0.5, 0.0), end=(0.6, 0.0))
    with pytest.raises(ValueError, match="no wall straight below"):
        doctor.bounce(load("reference"), "cpu", wall=plate)


def test_a_broken_backend_is_a_line_with_its_reason(monkeypatch):
    def broken(_name):
        raise BackendMissing("the backend numba cannot be loaded (no llvmlite)")

    monkeypatch.setattr(doctor, "load", broken)
    monkeypatch.setattr(doctor, "installed", lambda: {"numba": "labbook_numba:Backend"})
    found = doctor.examine()
    assert [backend.works for backend in found.backends] == [False]
    assert "no llvmlite" in found.backends[0].note


class TwoDevices(labbook_toy.Backend):
    """Says that it runs on two devices; on the second it cannot be opened."""

    def __init__(self):
        super().__init__()
        self.capabilities = replace(self.capabilities, devices=("cpu", "cuda:0"))


def test_every_device_is_a_line_that_works_or_says_why_not(monkeypatch):
    tried = []

    def bounce(backend, device):
        tried.append(device)
        if device == "cpu":
            return doctor.TARGET
        raise Unsupported("device", "the toy backend runs on cpu only")

    monkeypatch.setattr(doctor, "installed", lambda: {"toy": "labbook_toy:Backend"})
    monkeypatch.setattr(doctor, "load", lambda _name: TwoDevices())
    monkeypatch.setattr(doctor, "bounce", bounce)
    found = doctor.examine().backends
    assert [(backend.name, backend.device, backend.works) for backend in found] == [
        ("toy", "cpu", True),
        ("toy", "cuda:0", False),
    ]
    assert tried == ["cpu", "cuda:0"]
    assert "device: the toy backend runs on cpu only" in found[1].note
    result = CliRunner().invoke(build(), ["doctor"], env={"COLUMNS": "300"})
    assert result.exit_code == 0, "one device that works is enough"
    assert "letting a grain bounce with toy on cuda:0 (compiles the first time)" in result.stderr
    lines = [line for line in result.stdout.splitlines() if " toy " in line]
    assert ["yes" in line for line in lines] == [True, False]
    assert "runs on cpu only" in lines[1]


class Surveyed(TwoDevices):
    """Finds two GPUs, of which it is made for the first."""

    def survey(self):
        gpus = tuple(Device(f"cuda:{k}", "Toy GPU", (8 + k) * 2**30) for k in range(2))
        return Survey({"Toy": "7.1", "CUDA": "none"}, (Device("cpu", "toy CPU"), *gpus))


def test_every_device_that_is_there_is_named_with_its_memory(monkeypatch):
    monkeypatch.setattr(doctor, "installed", lambda: {"toy": "labbook_toy:Backend"})
    monkeypatch.setattr(doctor, "load", lambda _name: Surveyed())
    monkeypatch.setattr(doctor, "bounce", lambda _backend, _device: doctor.TARGET)
    found = doctor.examine()
    assert found.versions == {"toy": {"Toy": "7.1", "CUDA": "none"}}
    named = [(backend.device, backend.what) for backend in found.backends]
    assert named == [("cpu", "toy CPU"), ("cuda:0", "Toy GPU, 8 GiB"), ("cuda:1", "Toy GPU, 9 GiB")]
    result = CliRunner().invoke(build(), ["doctor"], env={"COLUMNS": "300"})
    assert "toy: Toy 7.1, CUDA none" in result.stdout
    assert "Toy GPU, 9 GiB" in result.stdout


def test_an_backend_that_cannot_look_around_is_a_line_with_its_reason(monkeypatch):
    class Blind(TwoDevices):
        def survey(self):
            raise RuntimeError("no library libtoy")

    monkeypatch.setattr(doctor, "installed", lambda: {"toy": "labbook_toy:Backend"})
    monkeypatch.setattr(doctor, "load", lambda _name: Blind())
    found = doctor.examine().backends
    assert [(backend.works, backend.note) for backend in found] == [(False, "RuntimeError: no library libtoy")]


def test_the_gpu_backend_names_what_it_stands_on():
    wp = pytest.importorskip("warp")
    backend = load("warp")
    found = backend.survey()
    assert found.versions["Warp"] == wp.config.version
    assert found.versions["CUDA that the driver supports"] != "none" or wp.get_cuda_device_count() == 0
    assert {device.alias for device in found.devices} == {device.alias for device in wp.get_devices()}
    assert all((device.memory is None) == (device.alias == "cpu") for device in found.devices)


def test_a_build_of_warp_without_a_cpu_device_is_not_told_to_use_it():
    pytest.importorskip("warp")
    from labbook_warp.devices import device_remedy

    said = device_remedy("cpu", ["cuda:0"])
    assert "this build of Warp has no CPU device" in said
    assert "use --backend numba, which is faster on a CPU, or --device cuda:0" in said
    assert (
        "(no CUDA device was found); use --backend numba, which is faster on a CPU, or --device cpu"
        in device_remedy("cuda:0", ["cpu"])
    )
    assert "--device" not in device_remedy("cpu", [])


def test_the_self_test_opens_the_device_it_is_asked_for():
    with pytest.raises(Unsupported, match="cuda:0"):
        doctor.bounce(load("numba"), "cuda:0")


def test_no_working_backend_is_exit_status_one(monkeypatch):
    monkeypatch.setattr(doctor, "installed", dict)
    result = CliRunner().invoke(build(), ["doctor", "--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout)["backends"] == []


@pytest.mark.parametrize(("backend", "marks"), [("numba", "@entry\ndef advance("), ("warp", "@hot_kernel\ndef step(")])
def test_the_module_of_kernels_of_a_study_is_printed(backend, marks):
    """As Python that says where its functions stand, with the law and walls of that study and no others."""
    words = ["doctor", "--kernel", str(ROOT / "studies/quickstart.yaml"), "--point", "2", "--backend", backend]
    shown = CliRunner().invoke(build(), words)
    assert shown.exit_code == 0, shown.output
    tree = ast.parse(shown.output)
    assert {"respond", "wall_distance", "strip_distance"} <= {
        n.name for n in tree.body if isinstance(n, ast.FunctionDef)
    }
    for text in (marks, "# labbook_dem.laws.hertz_mindlin\n@func", "# written by labbook_dem.dispatch"):
        assert text in shown.output
    for text in ("frustum_distance", "labbook_dem.laws.linear"):
        assert text not in shown.output


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (["--backend", "reference"], "docs/kernels.md"),
        (["--backend", "nobody"], "there are: "),
        (["--point", "99"], "has 5 points"),
    ],
)
def test_a_module_of_kernels_that_is_not_there_is_told(more, why):
    shown = CliRunner().invoke(build(), ["doctor", "--kernel", str(ROOT / "studies/quickstart.yaml"), *more])
    assert shown.exit_code == 1
    assert why in shown.output
