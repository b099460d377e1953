"""A lab for tests of the web app, made once a process."""

import re
import shutil
from pathlib import Path

import pytest
from toy_lab import labbook, study_file
from toy_web import make


@pytest.fixture(scope="session")
def done(tmp_path_factory) -> Path:
    """A folder with a study of four points with three replicates each, `toy.yaml`, and its lab. Not to be changed."""
    folder = tmp_path_factory.mktemp("web")
    make(folder, "about: Flow through an hourglass")
    return folder


@pytest.fixture
def copied(done, tmp_path) -> Path:
    """A copy of that folder."""
    shutil.copytree(done, tmp_path / "copied")
    return tmp_path / "copied"


@pytest.fixture(scope="session")
def plane(tmp_path_factory) -> Path:
    """A folder with a study of four outlets and two angles with two replicates each, `plane.yaml`, and its lab; the
    smallest outlet clogs. Not to be changed."""
    folder = tmp_path_factory.mktemp("plane")
    text = study_file(folder, count=300, replicates=2).read_text().replace("toy-study", "plane")
    swept = '  container.orifice: "[8, 18, 24, 30] mm"\n  container.angle: "[40, 90] deg"\n'
    path = folder / "plane.yaml"
    path.write_text(re.sub(r"  container\.orifice: .*\n", swept, text))
    labbook("run", path, "--lab", folder / "lab", "--backend", "toy", check=False)
    return folder
