"""What is shipped is what is in the tree, and importing labbook stays light."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
HEAVY = ("numba", "warp", "rerun", "sqlalchemy", "matplotlib", "PIL", "pandas", "scipy", "pint", "labbook_numba")


def tracked() -> list[Path]:
    """Files under version control, or that would be: what git neither tracks nor ignores."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout.decode()
    return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).is_file()]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> zipfile.ZipFile:
    """The wheel that `pip install .` would install."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return zipfile.ZipFile(next(folder.glob("*.whl")))


def test_every_package_of_the_tree_is_in_the_wheel_list():
    listed = set(PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"])
    roots = {"labbook"}
    for folder in ("backends", "web"):
        roots |= {f"{folder}/{path.parent.name}" for path in (ROOT / folder).glob("*/__init__.py")}
    assert roots == listed


def test_backends_and_web_hold_only_packages_with_names_of_their_own():
    for folder in ("backends", "web"):
        inside = [path for path in tracked() if path.is_relative_to(ROOT / folder)]
        for path in inside:
            parts = path.relative_to(ROOT / folder).parts
            assert len(parts) > 1, f"{path.relative_to(ROOT)} is a loose file"
            assert parts[0].startswith("labbook_")


def test_the_wheel_holds_every_module_and_every_data_file(wheel):
    inside = set(wheel.namelist())
    packages = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    for package in packages:
        base = ROOT / Path(package).parent
        for path in tracked():
            if path.is_relative_to(ROOT / package):
                assert path.relative_to(base).as_posix() in inside
    assert any(name.endswith(".html.j2") for name in inside)
    top = {name.split("/")[0] for name in inside if ".dist-info" not in name}
    assert top == {Path(package).name for package in packages}


@pytest.mark.parametrize("what", ["import labbook", "import labbook.scene, labbook.backend", "import labbook.cli"])
def test_importing_stays_light(what):
    code = f"import sys; {what}; print(*sys.modules)"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "backends")])}
    loaded = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    ).stdout.split()
    assert not sorted(set(HEAVY) & set(loaded))


def test_building_the_command_line_loads_nothing_heavy():
    code = "import sys, labbook.cli; labbook.cli.build(); print(*sys.modules)"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "backends")])}
    loaded = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    ).stdout.split()
    assert not sorted(set(HEAVY) & set(loaded))


def test_constraints_are_names_and_exact_versions_and_cover_what_is_needed():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.+!-]+", line) for line in pins)
    pinned = {_normal(line.split("==")[0]) for line in pins}
    extras = PROJECT["project"]["optional-dependencies"]
    needed = PROJECT["project"]["dependencies"] + [line for lines in extras.values() for line in lines]
    for requirement in needed:
        name = re.match(r"[A-Za-z0-9._-]+", requirement)
        assert name is not None
        assert _normal(name[0]) in pinned | {"labbook"}
    assert "labbook" not in pinned


def test_the_version_is_the_same_everywhere():
    import labbook

    assert labbook.__version__ == PROJECT["project"]["version"]


def test_nothing_names_this_machine_or_a_registry():
    absolute = r"(?<![\w.])/(?:work|root|home/\w+|tmp)/\w"
    registry = r"https?://[\w.-]*(?:pypi|pythonhosted|npmjs)[\w.-]*"
    words = [absolute, registry, "-".join(["extra", "index", "url"]), r"\.\./shared"]
    pattern = re.compile("|".join(words))
    for path in tracked():
        if path == Path(__file__) or path.suffix in {".png", ".npz", ".pdf"}:
            continue
        text = path.read_text(encoding="utf-8")
        found = pattern.search(text)
        assert not found, f"{path.relative_to(ROOT)} contains {found[0] if found else ''}"


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
