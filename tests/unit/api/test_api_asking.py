"""Ways to ask for a series, a figure, a run or a prediction, and what is said of those that there are not."""

import math
import re
import warnings
from ast import literal_eval
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from toy_lab import labbook as verb
from toy_lab import study
from toy_results import analyse

import labbook
from labbook.backend import Unsupported
from labbook.lab import LabFolder
from labbook.report.gallery import NothingToShow

ORIFICES = (0.018, 0.024, 0.03, 0.036)


def results_of(synthetic, points) -> labbook.Results:
    """Results of points with two runs each."""
    runs = [synthetic.FinishedDouble(one, seed) for one in points for seed in (1, 2)]
    kind = partial(labbook.Results, lab_folder=LabFolder(Path("nowhere")), backend="numba")
    return analyse(synthetic.study_of(points, replicates=2, reference=None, fit=("beverloo",)), runs, kind=kind)


@pytest.fixture(scope="module")
def two(synthetic):
    """Results of two angles with four orifices each."""
    places = [(angle, D) for angle in (math.pi / 3, math.pi / 2) for D in ORIFICES]
    return results_of(synthetic, [synthetic.point(k, D, angle) for k, (angle, D) in enumerate(places)])


@pytest.fixture(scope="module")
def one(synthetic):
    """Results of one series."""
    return results_of(synthetic, [synthetic.point(k, D) for k, D in enumerate(ORIFICES)])


def test_series_are_named_as_one_writes_them(two):
    with pytest.raises(LookupError, match="say which by `at`") as error:
        two.fit("beverloo")
    named = [literal_eval(text) for text in re.findall(r"\{[^}]*\}", str(error.value))]
    assert named == [{"container.angle": "60 deg"}, {"container.angle": "90 deg"}]
    for at in named:
        assert two.fit("beverloo", at=at).dof == 2


def test_the_last_part_of_a_key_will_do(two):
    assert two.fit("beverloo", at={"angle": "60 deg"}) is two.fit("beverloo", at={"container.angle": math.pi / 3})


@pytest.mark.parametrize(
    ("at", "said"),
    [
        ({"angle": "45 deg"}, r"0 series are at .*; there are: \{'container.angle': '60 deg'\}; "),
        ({"container.orifice": "18 mm"}, "container.orifice is the axis of every series and selects none"),
        ({"orifice": "18 mm"}, "series differ in container.angle"),
        ({"contact.friction": 0.2}, "series do not differ in contact.friction; known here: container.angle"),
        ({"container.angel": "60 deg"}, "did you mean container.angle"),
    ],
)
def test_a_series_that_is_not_there_is_said_with_those_that_are(two, at, said):
    with pytest.raises(LookupError, match=said):
        two.fit("beverloo", at=at)


def test_a_figure_that_is_not_there_is_said_before_a_series_is_asked_for(two, one):
    for found in (two, one):
        with pytest.raises(NothingToShow, match=r"no figure of these results is called nope; there are: .*flow_rate"):
            found.plot("nope")


def test_a_run_is_found_by_its_point_or_its_values(two):
    point = two.study.points[5]
    run = two.run(6, seed=2)
    assert two.run(point, 2) is run
    assert two.run(at={"container.orifice": "24 mm", "angle": "90 deg"}, seed=2) is run
    assert two.run(at=point.at, seed=2) is run
    assert two.run(np.int64(6), 2) is run
    for wrong in ("orifice 24 mm", 6.0, True):
        with pytest.raises(TypeError, match="a Point of the study or its number is needed"):
            two.run(wrong)
    with pytest.raises(TypeError, match="give a point"):
        two.run()
    with pytest.raises(LookupError, match=r"2 points are at .*'container.orifice': '24 mm'"):
        two.run(at={"orifice": "24 mm"})
    with pytest.raises(LookupError, match=r"does not sweep container.width; known here: "):
        two.run(at={"container.width": "24 mm"})


def test_a_list_that_is_cut_ends_with_dots_and_a_count(two):
    with pytest.raises(LookupError, match=r", \.\.\. \(16 in all\)$"):
        two.run(99)


def test_predictions_take_lengths_as_studies_do(one):
    fit = one.fit("beverloo")
    expected = fit.predict([0.02, 0.024])
    for D in (["20 mm", "24 mm"], ["2 cm", 0.024], np.array([0.02, 0.024]), np.array(["20 mm", "8 d"])):
        assert np.allclose(fit.predict(D), expected), D
    assert fit.predict("20 mm")[0].shape == (1,)
    for wrong in ("20 kg", "20", "wide"):
        with pytest.raises(ValueError, match=r"orifice: .*'20 mm'"):
            fit.predict(wrong)


def test_a_prediction_far_outside_the_fit_is_warned_of_where_it_is_asked_for(one):
    """The fitted orifices are 18 to 36 mm: half and twice that are 9 and 72 mm."""
    fit = one.fit("beverloo")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit.predict(["9 mm", "72 mm"])
        one.frames()
    for D in (20, "8.9 mm", [0.02, "73 mm"]):
        with pytest.warns(labbook.LabWarning, match="far outside the fitted range, 18 to 36 mm") as caught:
            fit.predict(D)
        assert caught[0].filename == __file__


@pytest.mark.parametrize("method", ["plan", "run"])
def test_a_device_that_is_not_there_is_named_as_python_does(tmp_path, method):
    asked, lab = study(tmp_path), labbook.Lab(tmp_path / "lab", "toy", device="gpu")
    with pytest.raises(
        Unsupported, match=r"^device: the backend toy has no gpu here; .*device='cpu' or leave device out"
    ):
        getattr(lab, method)(asked)
    ended = verb(method, tmp_path / "toy.yaml", "--lab", lab.folder, "--backend", "toy", "--device", "gpu", check=False)
    assert "Error: --device: the backend toy has no gpu here" in ended.output
    assert "use --device cpu or leave --device out" in ended.output
