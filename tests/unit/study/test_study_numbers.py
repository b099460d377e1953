"""Numbers of a study: whole ones in every spelling, and swept ones without the noise of floating-point arithmetic."""

import numpy as np
import pytest

import labbook
from labbook.plan.demand import demands
from labbook.study import StudyError, load
from labbook.study.keys import all_keys

BASE = {
    "name": "x",
    "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 600},
    "contact": {"law": "linear", "normal_stiffness": "2000 N/m", "friction": 0.5, "restitution": 0.5},
    "container": {"kind": "wedge-hopper", "width": "48 mm", "height": "200 mm", "thickness": "1.01 d"}
    | {"orifice": "21 mm"},
}
COUNTS = [key.name for key in all_keys() if key.type == "integer"]


def scene_keys(study):
    return [demand.shared.scene_key for demand in demands(study, 1)]


def labels(study):
    return [point.label for point in study.points]


def test_noise_of_an_arithmetic_is_rounded_in_value_key_and_label():
    """0.1 + 0.2 is 0.30000000000000004 in floating point."""
    noisy = labbook.define(BASE, sweep={"contact.friction": np.arange(0.1, 0.6, 0.1)})
    plain = labbook.define(BASE, sweep={"contact.friction": [0.1, 0.2, 0.3, 0.4, 0.5]})
    assert np.arange(0.1, 0.6, 0.1)[2] != 0.3
    assert labels(noisy) == labels(plain)
    assert [point.at for point in noisy.points] == [point.at for point in plain.points]
    assert scene_keys(noisy) == scene_keys(plain)


def test_so_are_quantities_with_units():
    noisy = labbook.define(BASE, sweep={"container.orifice": [f"{x} mm" for x in np.arange(20, 20.5, 0.1)]})
    plain = labbook.define(BASE, sweep={"container.orifice": "[20.0, 20.1, 20.2, 20.3, 20.4] mm"})
    assert labels(noisy)[2] == "orifice 20.2 mm"
    assert scene_keys(noisy) == scene_keys(plain)


@pytest.mark.parametrize(
    "varied",
    [
        {"sweep": {"zip": {"contact.friction": [0.1 + 0.2]}}},
        {"points": [{"contact.friction": 0.1 + 0.2}]},
        {"sweep": {"contact.friction": "[0.30000000000000004]"}},
        {"sweep": {"contact.friction": ["0.30000000000000004"]}},
    ],
)
def test_however_points_are_listed(varied):
    (point,) = labbook.define(BASE, **varied).points
    assert point.at == {"contact.friction": 0.3}
    assert point.label == "friction 0.3"


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("contact.friction", [0.3, 0.1 + 0.2]),
        ("contact.friction", [1 / 3, 1 / 3 + 1e-15]),
        ("container.orifice", ["20.2 mm", "20.200000000000003 mm"]),
        ("grains.count", [10000, "1e4"]),
    ],
)
def test_values_that_are_equal_to_12_digits_are_listed_twice(key, values):
    with pytest.raises(StudyError, match="is listed twice"):
        labbook.define(BASE, sweep={key: values})


def test_points_that_are_equal_to_12_digits_repeat_each_other():
    with pytest.raises(StudyError, match="repeats the point"):
        labbook.define(BASE, points=[{"contact.friction": 0.3}, {"contact.friction": 0.1 + 0.2}])


def test_a_ratio_and_its_decimals_are_the_same_runs(tmp_path):
    """Labels show what was written."""
    file = tmp_path / "x.yaml"
    labbook.define(BASE).save(file)
    file.write_text(file.read_text() + "sweep: {contact.tangential_stiffness: [1/3, 2/7]}\n")
    written = load(file)
    given = labbook.define(BASE, sweep={"contact.tangential_stiffness": [1 / 3, 2 / 7]})
    assert scene_keys(written) == scene_keys(given)
    assert labels(written) == ["tangential_stiffness 1/3", "tangential_stiffness 2/7"]
    assert labels(given)[0] == "tangential_stiffness 0.333333333333"


@pytest.mark.parametrize(
    "changes",
    [
        {"contact.friction": 0.1 + 0.2},
        {"contact.friction": "0.30000000000000004"},
        {"contact.friction": np.arange(0.1, 0.6, 0.1)[2], "container.orifice": f"{20.900000000000002 + 0.1} mm"},
    ],
)
def test_values_that_are_not_swept_have_no_noise_either(changes):
    plain = labbook.define(BASE).change({"contact.friction": 0.3})
    assert scene_keys(labbook.define(BASE).change(changes)) == scene_keys(plain)


def test_ratios_keep_all_their_digits():
    """Where they are not swept: keys of studies that state them are as they were."""
    for third in (1 / 3, "1/3"):
        (point,) = labbook.define(BASE).change({"contact.tangential_stiffness": third}).points
        assert point.value("contact.tangential_stiffness") == 1 / 3


def test_numbers_with_few_digits_and_large_ones_stay():
    values = [0.1, 1e-5, 12345.6789, 123456789012.0]
    swept = labbook.define(BASE, sweep={"contact.tangential_damping": [0.1, 1e-5, 12345.6789]})
    assert [point.at["contact.tangential_damping"] for point in swept.points] == values[:3]


def test_all_whole_numbers_are_known_here():
    assert {*COUNTS} == {
        "replicates",
        "discharges_per_bed",
        "accuracy.max_replicates",
        "record.replicates",
        "grains.count",
        "numerics.steps_per_beat",
        "fill.numerics.steps_per_beat",
    }


@pytest.mark.parametrize("key", COUNTS)
@pytest.mark.parametrize("text", ["1e2", "1.0e+2", "100.0", "+1E2", '"1e2"', "100"])
def test_whole_numbers_in_every_spelling(tmp_path, key, text):
    more = {"replicates": 8000} if key == "record.replicates" else {}
    file = labbook.define(BASE).change({**more, key: 7777}).save(tmp_path / "x.yaml")
    file.write_text(file.read_text().replace("7777", text))
    study = load(file)
    of_study = {
        "replicates": study.replicates,
        "discharges_per_bed": study.discharges_per_bed,
        "accuracy.max_replicates": study.accuracy.max_replicates,
        "record.replicates": study.record and study.record.replicates,
    }
    assert (of_study[key] if key in of_study else study.points[0].value(key)) == 100


@pytest.mark.parametrize("values", ["[1e2, 2e2, 1000]", [1e2, 200.0, 1000], ["1e2", "2.0e+2", 1000]])
def test_whole_numbers_of_a_sweep(values):
    study = labbook.define(BASE, sweep={"grains.count": values})
    assert labels(study) == ["count 100", "count 200", "count 1000"]
    assert [point.scene.grains.count for point in study.points] == [100, 200, 1000]


@pytest.mark.parametrize("key", COUNTS)
@pytest.mark.parametrize("wrong", [1.5, "1.5", True, "1e400", float("inf"), "many", "100 %", "1e2 mm", "3/2"])
def test_other_numbers_are_no_whole_numbers(key, wrong):
    with pytest.raises(StudyError, match=f"{key}: .*a whole number is needed|{key}: .*out of range"):
        labbook.define(BASE).change({key: wrong})
