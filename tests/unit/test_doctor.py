"""The doctor lets engines work, and reports one that is broken."""

import json

import pytest
from typer.testing import CliRunner

from labbook import backend, doctor
from labbook.cli import build


def test_the_cpu_engine_bounces_a_grain():
    engine = backend.load("numba")
    assert doctor.bounce(engine) == pytest.approx(doctor.ASKED, abs=2e-3)


def test_a_broken_engine_is_a_line_with_its_reason(monkeypatch):
    def broken(_name):
        raise backend.BackendMissing("the engine numba is there but cannot be loaded (no llvmlite)")

    monkeypatch.setattr(backend, "load", broken)
    monkeypatch.setattr(backend, "installed", lambda: {"numba": "labbook_numba:Backend"})
    found = doctor.examine()
    assert [engine.works for engine in found.engines] == [False]
    assert "no llvmlite" in found.engines[0].note


def test_no_working_engine_is_exit_status_one(monkeypatch):
    monkeypatch.setattr(backend, "installed", dict)
    result = CliRunner().invoke(build(), ["doctor", "--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout)["engines"] == []
