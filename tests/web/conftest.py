"""A lab for tests of the web app, made once a process."""

import shutil
from pathlib import Path

import pytest
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
