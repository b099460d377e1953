"""A class name stands in one module, so that a reader who meets it knows the class."""

import re
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[3]
_CLASS = re.compile(r"^ *class (\w+)[(:]", re.MULTILINE)
BACKENDS = ("labbook_numba", "labbook_reference", "labbook_warp")
REPEATED = {
    # each backend's part of the contract; its package is the name's other half
    "Backend": {"labbook.backend.contract", *BACKENDS},
    "Ensemble": {"labbook.backend.contract", "labbook_dem.ensemble", *(f"{name}.ensemble" for name in BACKENDS)},
    "Shape": {"labbook_dem.shapes", "labbook_numba.shapes", "labbook_warp.shapes"},
    # a member while it is stepped, in each backend; `Run` of Python is public
    "Run": {"labbook.api.run", "labbook_numba.member", "labbook_reference.member", "labbook_warp.run"},
    # records of kernels: a module for each shape stands in for `shape`, so the names are an interface
    "Grain": {f"labbook_warp.kernels.{name}" for name in ("shape", "rods", "spheres")},
    "Private": {f"labbook_warp.kernels.{name}" for name in ("shape", "rods", "spheres")},
    # a record of kernels, whose name is in compiled code; `Material` of scenes is public
    "Material": {"labbook.scene.material", "labbook_warp.kernels.system"},
    # the protocol that measures of other packages name, and the model of the study's key that fulfils it
    "Window": {"labbook.measure.measure", "labbook.study.schema"},
}
"""Names that more than one module may define, with these modules."""


def modules_of_classes(root: Path) -> dict[str, set[str]]:
    """Modules that define a class, by its name."""
    defined: dict[str, set[str]] = defaultdict(set)
    for folder in ("labbook", "backends", "web"):
        base = root if folder == "labbook" else root / folder
        for path in (root / folder).rglob("*.py"):
            module = ".".join(path.relative_to(base).with_suffix("").parts).removesuffix(".__init__")
            for name in _CLASS.findall(path.read_text(encoding="utf-8")):
                defined[name].add(module)
    return defined


def test_no_class_name_stands_in_two_modules_without_need():
    repeated = {name: modules for name, modules in modules_of_classes(ROOT).items() if len(modules) > 1}
    assert repeated == REPEATED, "rename the class that is new, or name the need in REPEATED"


def test_a_name_in_two_modules_is_found(tmp_path):
    for path in ("labbook/one.py", "backends/labbook_two/other.py"):
        (tmp_path / path).parent.mkdir(parents=True)
        (tmp_path / path).write_text("class Same:\n    class Inner: ...\n")
    expected = {"labbook.one", "labbook_two.other"}
    assert modules_of_classes(tmp_path) == {"Same": expected, "Inner": expected}
