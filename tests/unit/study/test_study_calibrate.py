"""The sections `calibrate` and `include`: what is read, and every mistake with its remedy."""

import pytest
from toy_lab import study, study_file

from labbook.campaign import Calibrate
from labbook.study import StudyError, load

MEASURED = "container.orifice [mm],value [g/s],error [g/s]\n18,20,0.4\n24,35,0.7\n30,52,1\n"
PARAMETERS = "parameters: {contact.friction: {uniform: [0.1, 0.9]}, grains.density: {loguniform: [1 g/cm^3, 4 g/cm^3]}}"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "measured.csv").write_text(MEASURED)
    return tmp_path


def asked(folder, section: str, *more: str):
    reference = () if any(line.startswith("reference") for line in more) else ("reference: {file: measured.csv}",)
    return study(folder, *reference, *more, section, orifices="[18, 24, 30]")


def test_it_is_a_strategy_in_si(folder):
    goal = asked(folder, f"calibrate: {{{PARAMETERS}, discrepancy: 3 %, accuracy: {{contact.friction: 5 %}}, "
                         "predict: [{container.orifice: 24 mm}], batch: 64, budget: 900 runs}").adapt  # fmt: skip
    assert isinstance(goal, Calibrate)
    density = goal.parameters["grains.density"]
    assert (density.low, density.high, density.logarithmic) == (1000, 4000, True)
    assert (goal.discrepancy, goal.accuracy, goal.batch, goal.budget) == (0.03, {"contact.friction": 0.05}, 64, 900)
    assert [(one.value, one.error, one.withheld) for one in goal.measurements] == [
        (pytest.approx(0.02), pytest.approx(0.0004), False),
        (pytest.approx(0.035), pytest.approx(0.0007), True),
        (pytest.approx(0.052), pytest.approx(0.001), False),
    ]


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("calibrate: 3", "a mapping of keys is needed"),
        ("calibrate: {discrepancy: 3 %}", "parameters with their priors are needed"),
        (f"calibrate: {{{PARAMETERS}}}", "calibrate.discrepancy: a fraction from 0 to 1 is needed"),
        (f"calibrate: {{{PARAMETERS}, discrepancy: 3 %, prior: 2}}", "calibrate.prior: unknown key"),
        ("calibrate: {parameters: {contact.frictoin: {uniform: [0, 1]}}, discrepancy: 0}", "did you mean"),
        ("calibrate: {parameters: {contact.friction: {normal: [0, 1]}}, discrepancy: 0}", "is no prior"),
        ("calibrate: {parameters: {contact.friction: {uniform: [1, 0]}}, discrepancy: 0}", "1 and 0 are no range"),
        ("calibrate: {parameters: {contact.friction: {loguniform: [0, 1]}}, discrepancy: 0}", "are no range"),
        ("calibrate: {parameters: {grains.density: {uniform: [1, 2]}}, discrepancy: 0}", "the unit is missing"),
        ("calibrate: {parameters: {container.orifice: {uniform: [1 mm, 2 mm]}}, discrepancy: 0}", "is swept as well"),
        (f"calibrate: {{{PARAMETERS}, discrepancy: 0, accuracy: {{gravity: 2 %}}}}", "this is no parameter"),
        (f"calibrate: {{{PARAMETERS}, discrepancy: 0, predict: [24 mm]}}", "a list of conditions is needed"),
        (f"calibrate: {{{PARAMETERS}, discrepancy: 0, batch: 3}}", "3 runs are no round"),
        (f"calibrate: {{{PARAMETERS}, discrepancy: 0, budget: some}}", "is no budget"),
        (f"calibrate: {{{PARAMETERS}, discrepancy: 0, batch: some}}", "is no number of runs"),
    ],
)  # fmt: skip
def test_mistakes_are_told(folder, section, message):
    with pytest.raises(StudyError, match="remedy") as error:
        asked(folder, section)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("reference: {source: own}", "there is no measured value to calibrate with"),
        (
            "reference: {source: own, flow_rate: {at: {container.orifice: 18 mm}, value: 20 g/s}}",
            "the standard error is",
        ),
        ("reference: {source: own, flow_rate: {value: 20 g/s, error: 1 g/s}}", "at which container.orifice"),
    ],
)
def test_measurements_have_to_be_complete(folder, reference, message):
    with pytest.raises(StudyError) as error:
        asked(folder, f"calibrate: {{{PARAMETERS}, discrepancy: 3 %}}", reference)
    assert message in str(error.value)


def test_it_stands_alone(folder):
    with pytest.raises(StudyError, match="the study has `adapt` as well"):
        asked(folder, f"calibrate: {{{PARAMETERS}, discrepancy: 3 %}}",
              "adapt: {find: {container.orifice: {flow_rate: 30 g/s, within: 2 %}}}")  # fmt: skip


def test_a_study_includes_a_card(tmp_path):
    """What it states itself goes before; the study has the same points as one that states all."""
    (tmp_path / "glass.material.yaml").write_text("contact: {friction: 0.31, restitution: 0.9}\ngravity: 9.81 m/s^2\n")
    whole = load(study_file(tmp_path))
    path = study_file(tmp_path, "include: glass.material.yaml")
    path.write_text(path.read_text().replace("friction: 0.5, restitution: 0.2", "restitution: 0.2"))
    included = load(path)
    assert included.points[0].scene.contact.friction == 0.31
    assert included.points[0].scene.contact.restitution == 0.2
    assert included.points == whole.change({"contact.friction": 0.31}).points
    assert "include" not in included.definition
    again = included.change({"contact.friction": 0.4})
    assert again.points[0].scene.contact.friction == 0.4


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "cannot be read"), ("sweep: {}", "a study does not include this key"), ("a: [", "not valid YAML")],
)
def test_a_card_that_cannot_be_included(tmp_path, content, message):
    if content is not None:
        (tmp_path / "glass.yaml").write_text(content)
    with pytest.raises(StudyError, match=message):
        study(tmp_path, "include: glass.yaml")
