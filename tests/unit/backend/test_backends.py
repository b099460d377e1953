"""Backends: what they inherit, how they are found, and plans on a machine that lacks their packages."""

import ast
import json
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import labbook_toy
import pytest
from toy_lab import ROOT, study, study_file

import labbook
from labbook.backend import Backend, BackendMissing, Checkpoint, Ensemble, load, load_to_plan, registry


class Plain(labbook_toy.Backend):
    """A backend that defines no more than it must."""

    compiling, verify = Backend.compiling, Backend.verify


def test_what_a_backend_need_not_define_does_nothing(tmp_path):
    backend, point = Plain(), study(tmp_path).points[0]
    spec = backend.specialise(point.scene, point.numerics)
    assert backend.missing() == ()
    assert backend.compiling() is False
    assert backend.generated(spec) is None
    assert backend.compiled(spec) is False
    assert backend.bandwidth("cpu") is None
    assert backend.capacity(spec, point.scene, "cpu") is None
    assert [(device.alias, device.memory) for device in backend.survey().devices] == [("cpu", None)]
    backend.precompile((), "cpu")
    backend.verify(point.scene, point.numerics, Checkpoint("another", 0, {}), 0)
    assert backend.open(spec, 1).load() is None


class Idle(Backend):
    """A backend that only opens."""

    def open(self, spec, slots=None, device="cpu"):
        raise NotImplementedError


def test_what_an_ensemble_must_define_is_known():
    assert {"admit", "advance", "drain", "put_back"} <= Ensemble.__abstractmethods__


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("builtins:dict", "builtins:dict is no backend: derive it from labbook"),
        (f"{__name__}:Idle", r"Idle is no backend \(.* describe.*specialise"),
    ],
)
def test_a_class_that_is_no_backend_is_refused(monkeypatch, value, message):
    entry = EntryPoint("mine", value, registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda group: [entry])
    with pytest.raises(BackendMissing, match=message):
        load_to_plan("mine")


def test_a_backend_without_its_package_plans_and_does_not_run(monkeypatch):
    monkeypatch.setattr(labbook_toy.Backend, "requires", ("nowhere_to_be_found",))
    assert load_to_plan("toy").missing() == ("nowhere_to_be_found",)
    with pytest.raises(BackendMissing, match=r"needs the package nowhere_to_be_found.*pip install 'labbook\[toy\]'"):
        load("toy")


PLANS = """
import json, sys

sys.modules.update(dict.fromkeys(sys.argv[3:]))  # importing these fails
import labbook
from labbook.backend import BackendMissing

study, told = labbook.load(sys.argv[1]), {}
for backend, device in (("numba", "cpu"), ("warp", "cpu"), ("warp", "cuda:0")):
    lab = labbook.Lab(sys.argv[2], backend, device)
    plan = lab.plan(study)
    try:
        lab.run(study, progress=False)
    except BackendMissing as error:
        refused = str(error)
    keys = [(item.keys.packing, item.keys.run) for item in plan.items]
    told[f"{backend} {device}"] = keys, plan.forecast.seconds, plan.warnings, refused
print(json.dumps(told))
"""


@pytest.mark.slow
def test_plans_and_keys_need_no_package_of_a_backend(tmp_path):
    """`numba` and `warp` cannot be imported in the process that plans; here they can."""
    path = study_file(tmp_path)
    command = [sys.executable, "-c", PLANS, str(path), str(tmp_path / "lab"), "numba", "llvmlite", "warp"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr
    told, asked = json.loads(done.stdout), labbook.load(path)
    for place, (keys, seconds, warnings, refused) in told.items():
        backend, _ = place.split()
        assert f"the backend {backend} needs the package {backend}, which is not installed" in refused
        assert any(line.startswith(refused) for line in warnings)
        plan = labbook.Lab(tmp_path / "lab", backend).plan(asked)
        assert keys == [[item.keys.packing, item.keys.run] for item in plan.items]
        assert len(keys) == 4
        assert seconds > 0
        assert not any("not installed" in line for line in plan.warnings)


def _strings(path: Path) -> list[str]:
    """String constants of a module, without docstrings and the docstrings of attributes."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    texts = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    found = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in texts)
    return [node.value for node in found if isinstance(node.value, str)]


def test_no_string_of_labbook_names_the_package_of_a_backend():
    """The import checker cannot see an arrow in a string. Docstrings may say where formulas are."""
    packages = [path.name for path in (ROOT / "backends").iterdir() if (path / "__init__.py").exists()]
    assert {"labbook_dem", "labbook_numba", "labbook_warp"} <= set(packages)
    for path in (ROOT / "labbook").rglob("*.py"):
        for text in _strings(path):
            assert not any(package in text for package in packages), f"{path.relative_to(ROOT)}: {text}"
