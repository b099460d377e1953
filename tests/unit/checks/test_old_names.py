"""Former names of attributes and of the module of test platforms: they give the same values, and warn."""

from importlib import import_module

import pytest

from labbook import Lab, Results, Run
from labbook.checks.verify import platform
from labbook.results.against import Line
from labbook.results.arch import PointArches
from labbook.results.budget import Share
from labbook.results.clogging import PointClogging
from labbook.results.outlets import OutletResult
from labbook.results.points import PointResult
from labbook.results.series import Series
from labbook.warning import RenamedAttribute

RENAMED = [
    (Lab, "place", "lab_folder"),
    (Results, "place", "lab_folder"),
    (Run, "place", "lab_folder"),
    (Line, "places", "points"),
    (PointArches, "width", "width_ratio"),
    (PointClogging, "place", "outlet_index"),
    (PointClogging, "width", "width_ratio"),
    (OutletResult, "place", "outlet_index"),
    (PointResult, "interval", "acceleration_interval"),
    (Series, "diameters", "orifices"),
    (Share, "part", "relative"),
]


def test_a_former_name_gives_the_value_of_the_new_one_and_warns(tmp_path):
    lab = Lab(tmp_path)
    with pytest.warns(DeprecationWarning, match=r"^Lab\.place is now called lab_folder$") as told:
        assert getattr(lab, "place").folder == tmp_path  # noqa: B009
    assert told[0].filename == __file__


@pytest.mark.parametrize(("kind", "old", "new"), RENAMED, ids=lambda value: getattr(value, "__name__", value))
def test_every_former_name_has_a_new_one(kind, old, new):
    assert isinstance(vars(kind)[old], RenamedAttribute)
    assert new in dir(kind) or new in kind.__dataclass_fields__
    blank = object.__new__(kind)
    object.__setattr__(blank, "__class__", type(kind.__name__, (kind,), {new: 42}))
    with pytest.warns(DeprecationWarning, match=new):
        assert getattr(blank, old) == 42


@pytest.mark.parametrize(("old", "new"), [("Stand", "Platform"), ("Motion", "Trajectory"), ("grains_at", "grains_at")])
def test_the_former_module_of_platforms_has_their_names(old, new):
    former = import_module("labbook.checks.verify." + "stand")
    with pytest.warns(DeprecationWarning, match=rf"is now labbook\.checks\.verify\.platform\.{new}"):
        assert getattr(former, old) is getattr(platform, new)
