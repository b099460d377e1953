"""Former names of attributes and of the module of test platforms: they give the same values, and warn."""

from importlib import import_module
from typing import ClassVar

import pytest

from labbook import Lab, Results, Run, campaign
from labbook.checks.verify import platform
from labbook.results.against import Line
from labbook.results.arch import PointArches
from labbook.results.budget import Share
from labbook.results.clogging import PointClogging
from labbook.results.outlets import OutletResult
from labbook.results.points import PointResult
from labbook.results.series import Series
from labbook.scene import BedTop, Packing, Plane
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
    (Packing, "part", "subset"),
    (BedTop, "part", "subset"),
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


def test_a_former_name_of_a_package_is_a_function():
    with pytest.warns(DeprecationWarning, match="is now called point_key"):
        assert getattr(campaign, "place") is campaign.point_key  # noqa: B009


def test_classes_of_other_packages_may_define_former_names():
    with pytest.warns(DeprecationWarning, match="Glass.pane is now called is_transparent"):

        class Glass(Plane):
            @property
            def pane(self) -> bool:
                return True

    with pytest.warns(DeprecationWarning, match="Design.places is now called point_noun"):

        class Design(campaign.Goal):
            places: ClassVar[str] = "designs"

    assert Glass(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0)).is_transparent
    assert Design.point_noun == "designs"
