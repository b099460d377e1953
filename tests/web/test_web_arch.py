"""The page of a run that measured its arch shows the bed near the outlet at its last stop."""

from base64 import b64decode
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

pytest.importorskip("starlette")

from labbook_web.pages import run

from labbook.backend.numerics import Numerics
from labbook.checks.verify.materials import D, G, hertz, scene
from labbook.lab.evaluations import NotEvaluated
from labbook.measure.arch import StoppedBed
from labbook.scene import WedgeHopper

BED = StoppedBed(
    ids=np.arange(3), x=np.array([[-1.4, 0, 0.5], [0, 0, 1.0], [1.4, 0, 0.5]]) * D, pairs=np.array([[0, 1], [1, 2]]),
    force=np.array([4.0, 2.0]), rows=np.arange(3), link=np.array([4.0, 2.0]),
    links=np.array([[0, 1], [1, 2]]),
)  # fmt: skip


def picture(monkeypatch, arrays, measure=("arch",)) -> tuple[str, str]:
    def evaluated(*_):
        if arrays is None:
            raise NotEvaluated("arch", "0" * 24)
        return SimpleNamespace(evaluation=SimpleNamespace(arrays=arrays))

    monkeypatch.setattr(run, "ReadOnlyRun", lambda *_: SimpleNamespace(evaluated=evaluated))
    hopper = WedgeHopper(width=0.06, height=0.2, thickness=1.01 * D, orifice=2.5 * D)
    record = SimpleNamespace(
        observe=SimpleNamespace(measure=measure), scene=scene(3, hertz(), hopper, G), seed=1, point=0,
        numerics=Numerics(dt=1e-6), at={}, label="",
    )  # fmt: skip
    nothing = cast(Any, None)
    return run.arch(nothing, nothing, cast(Any, record))


def test_it_is_an_image_with_its_data(monkeypatch):
    address, words = picture(monkeypatch, BED.arrays())
    kind, _, data = address.partition(",")
    assert kind == "data:image/svg+xml;base64"
    assert b"<svg" in b64decode(data)
    assert words == "Held by 3 grains, with forces along them of 2 to 4 grain weights; D = 2.5 d."


def test_runs_without_an_arch_or_that_were_not_evaluated_have_none(monkeypatch):
    assert picture(monkeypatch, {"size": np.array([])}) == ("", "")
    assert picture(monkeypatch, None) == ("", "")
    assert picture(monkeypatch, BED.arrays(), measure=("flow_rate",)) == ("", "")
