"""What is shipped is what is in the tree, type checkers read it, and importing labbook stays light."""

import ast
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email import message_from_bytes
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import labbook

ROOT = Path(__file__).parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
AUTHORS = "The labbook authors"
LARGE = 150_000
"""Bytes of a file that needs a reason to be in the archive of the sources."""
LARGE_FILES = {
    "web/labbook_web/static/vendor/plotly-basic-4.1.1.min.js",
    "tests/unit/lab/kept_keys.json",
}
BACKENDS = ("labbook_reference", "labbook_numba")
REVEALED = ['labbook.load("study.yaml")', *(f"{name}.Backend()" for name in BACKENDS)]
DECLARED = {
    "labbook": ("numba", "viewer", "cluster", "mesh", "learn"),
    "backends/labbook_dem": (),
    "backends/labbook_reference": (),
    "backends/labbook_numba": ("numba",),
    "backends/labbook_warp": ("warp",),
    "web/labbook_web": ("web",),
}
"""Each package, and the extras beside the dependencies of which it may import."""
ABSENT = {"IPython"}
"""Imported only in the notebooks that it runs."""
HEAVY = ("numba", "warp", "rerun", "sqlalchemy", "matplotlib", "PIL", "pandas", "scipy", "pint", "labbook_numba")


def tracked() -> list[Path]:
    """Files under version control, or that would be: what git neither tracks nor ignores."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout.decode()
    return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).is_file()]


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A folder with the wheel that `pip install .` would install, and the archive of the sources."""
    folder = tmp_path_factory.mktemp("built")
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def wheel(built) -> zipfile.ZipFile:
    return zipfile.ZipFile(next(built.glob("*.whl")))


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


def test_the_wheel_holds_every_module_and_every_data_file_and_nothing_else(wheel):
    packages = [Path(package) for package in PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]]
    ours = [(path, package) for path in tracked() for package in packages if path.is_relative_to(ROOT / package)]
    expected = {path.relative_to(ROOT / package.parent).as_posix() for path, package in ours}
    assert {name for name in wheel.namelist() if ".dist-info/" not in name} == expected
    assert any(name.endswith(".html.j2") for name in expected)
    assert {f"{package.name}/py.typed" for package in packages} <= expected


def test_the_wheel_states_licence_author_platform_and_version(wheel):
    (name,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
    stated = message_from_bytes(wheel.read(name))
    assert stated["Version"] == labbook.__version__
    assert stated["Author"] == AUTHORS
    assert stated["License-Expression"] == "MIT"
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in wheel.namelist())
    assert "Operating System :: POSIX" in stated.get_all("Classifier", []), "labbook.lab needs fcntl"


def test_the_archive_of_the_sources_is_small_and_builds_the_same_wheel(built, wheel, tmp_path):
    (archive,) = built.glob("*.tar.gz")
    data = "keep measured data and pictures out of it (tool.hatch.build.targets.sdist)"
    assert archive.stat().st_size < 3_400_000, data
    with tarfile.open(archive) as packed:
        large = {member.name.partition("/")[2] for member in packed.getmembers() if member.size > LARGE}
        assert large <= LARGE_FILES, data
        safely = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}  # Python 3.11.2 has none
        packed.extractall(tmp_path, **safely)  # pyright: ignore[reportArgumentType]
    (root,) = tmp_path.iterdir()
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=root, check=True, capture_output=True)
    again = zipfile.ZipFile(next(tmp_path.glob("*.whl")))
    assert {info.filename: info.CRC for info in again.infolist()} == {
        info.filename: info.CRC for info in wheel.infolist()
    }


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """The interpreter of an environment with labbook from its wheel; dependencies come from the tests' environment."""
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    (packages,) = folder.glob("lib/python*/site-packages")
    wheel.extractall(packages)
    needed = [path for path in sys.path if Path(path).name == "site-packages"]
    (packages / "needed.pth").write_text("\n".join(needed), encoding="utf-8")
    return folder / "bin" / "python"


CHECKERS = {
    "mypy": (["--python-executable"], r"user\.py:(\d+): note: Revealed type is \"(.*)\""),
    "pyright": (["--pythonpath"], r"user\.py:(\d+):\d+ - information: Type of \".*\" is \"(.*)\""),
}
"""Type checkers: how they are told the interpreter, and how they print a type."""


@pytest.mark.slow
# mypy takes 20 s; pyright reads the same types
@pytest.mark.parametrize("checker", [pytest.param("mypy", marks=pytest.mark.ring), "pyright"])
def test_type_checkers_read_the_types_of_an_installed_labbook(checker, installed, tmp_path):
    revealed = [f"labbook.{name}" for name in labbook.__all__] + REVEALED
    lines = ["import labbook", *(f"import {name}" for name in BACKENDS), *(f"reveal_type({code})" for code in revealed)]
    lines.append('labbook.Lab("lab").run("study.yaml")  # a path where a study is needed')
    script = tmp_path / "user.py"
    script.write_text("\n".join(lines) + "\n", encoding="utf-8")
    options, pattern = CHECKERS[checker]
    command = [sys.executable, "-m", checker, *options, str(installed), script.name]
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "MYPYPATH")}
    printed = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True).stdout
    types = {lines[int(line) - 1]: found for line, found in re.findall(pattern, printed)}
    for code in revealed:
        assert types.get(f"reveal_type({code})", "Any") not in ("Any", "Unknown", "Never"), (code, printed)
    assert types['reveal_type(labbook.load("study.yaml"))'].endswith("Study")
    errors = re.findall(r"user\.py:(\d+):(?:\d+ -)? error", printed)
    assert errors == [str(len(lines))], printed


def test_every_package_that_is_imported_is_declared():
    extras = PROJECT["project"]["optional-dependencies"]
    core = PROJECT["project"]["dependencies"]
    installed = packages_distributions()
    for folder, more in DECLARED.items():
        declared = {_name(line) for line in [*core, *(line for extra in more for line in extras[extra])]}
        for path in sorted((ROOT / folder).rglob("*.py")):
            for module in _imported(path):
                if module in sys.stdlib_module_names or module.startswith("labbook") or module in ABSENT:
                    continue
                names = {_normal(name) for name in installed.get(module, [module])}
                assert names & declared, (
                    f"{path.relative_to(ROOT)} imports {module}: name its package in pyproject.toml"
                )


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
    assert {_name(requirement) for requirement in needed} <= pinned | {"labbook"}
    assert "labbook" not in pinned


def test_nothing_names_this_machine_or_a_registry():
    absolute = r"(?<![\w.])/(?:work|root|home/\w+|tmp)/\w"
    registry = r"https?://[\w.-]*(?:pypi|pythonhosted|npmjs)[\w.-]*"
    words = [absolute, registry, "-".join(["extra", "index", "url"]), r"\.\./shared"]
    pattern = re.compile("|".join(words))
    for path in tracked():
        if path == Path(__file__) or path.suffix in {".png", ".webp", ".npz", ".pdf", ".gz"}:
            continue
        text = path.read_text(encoding="utf-8")
        found = pattern.search(text)
        assert not found, f"{path.relative_to(ROOT)} contains {found[0] if found else ''}"


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _name(requirement: str) -> str:
    """Normalised name of the package that a requirement is about."""
    name = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert name is not None
    return _normal(name[0])


def _imported(path: Path) -> set[str]:
    """Top-level packages that a module imports, wherever in it."""
    imported = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            imported.add(node.module.partition(".")[0])
    return imported
