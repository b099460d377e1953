"""`labbook calibrate` on the toy backend, whose flow rate is proportional to the density of grains."""

import json
import math
import re
import shlex
from contextlib import suppress
from pathlib import Path

import pytest
from labbook_toy import Backend
from toy_lab import carry_out, labbook, study_file

from labbook.api import Lab
from labbook.lab import LabFolder
from labbook.results.calibrated import NoPosterior
from labbook.run.runner import Runner
from labbook.study import load

pytest.importorskip("sklearn")
HOWTO = (Path(__file__).parents[3] / "docs/howto.md").read_text(encoding="utf-8")
d = 3e-3


def flow(density: float, D: float) -> float:
    """Mean flow rate [kg/s] of the toy backend through a round outlet."""
    return 0.6 * density * math.sqrt(9.81) * (D - 1.4 * d) ** 2.5


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """The recipe of docs/howto.md with the density as its parameter, in smaller rounds with fewer grains: study, lab,
    and what its commands print. The measurements are of a density of 2200 kg/m^3, to 4 %."""
    section = HOWTO.split("\n## Find the friction from measured flow rates\n")[1].split("\n## ")[0]
    table, text = (re.search(rf"```{kind}\n(.*?)```", section, re.DOTALL) for kind in ("text", "yaml"))
    assert table is not None
    assert text is not None
    folder = tmp_path_factory.mktemp("calibrate")
    head, *rows = table[1].splitlines()
    outlets = [float(row.split(",")[0]) for row in rows]
    values = [1e3 * flow(2200, 1e-3 * D) for D in outlets]
    lines = [f"{D},{value},{0.04 * value}" for D, value in zip(outlets, values, strict=True)]
    (folder / "measured.csv").write_text("\n".join([head, *lines]))
    priors = ("contact.friction: {uniform: [0.1, 0.9]}", "grains.density: {uniform: [1500 kg/m^3, 3 g/cm^3]}")
    study = text[1].replace(*priors)
    study = study.replace("count: 2000", "count: 160") + "  batch: 8\nwindow: {start: 0.15, end: 0.6}\n"
    study += "numerics: {dt: 10 us, steps_per_beat: 200, precision: double}\n"
    path = folder / "glass-friction.yaml"
    path.write_text(study)
    commands = [line for block in re.findall(r"```sh\n(.*?)```", section, re.DOTALL) for line in block.splitlines()]
    options, outputs = ("--lab", folder / "lab", "--backend", "toy"), {}
    for line in commands:
        _, verb, name = shlex.split(line, comments=True)
        assert name == path.name
        outputs[verb] = labbook(verb, path, *options).output
    assert "Goal: grains.density from 2 measured values" in outputs["plan"]
    return path, options, outputs["calibrate"]


@pytest.mark.slow
def test_it_gives_the_parameter_and_a_card(calibrated):
    """The interval has the density, and is about as wide as two measurements to 5 % (with the discrepancy) allow."""
    path, options, printed = calibrated
    ended = labbook("calibrate", path, *options, "--no-run", "--json")
    plain = json.loads(ended.stdout)
    density = plain["parameters"]["grains.density"]
    assert density["low"] < 2200 < density["high"]
    assert all(entry["quantity"] != "flow_drift" for entry in plain["next"]), (
        "a drift has either sign, and no logarithm"
    )
    assert (density["high"] - density["low"]) / 2 == pytest.approx(1.96 * 0.05 / math.sqrt(2) * 2200, rel=0.35)
    assert plain["lacking"] is None
    assert plain["campaign"][-1].startswith("calibrate has ended: grains.density = ")
    assert "calibrate has ended: grains.density = " in printed
    (prediction,) = plain["predictions"]
    assert prediction["interval"]["low"] < prediction["measured"] < prediction["interval"]["high"]
    assert "Prediction: W at D = 24 mm" in printed
    card = path.with_suffix(".material.yaml")
    assert card.name in printed
    reader = study_file(path.parent / "..", f"include: {path.parent.name}/{card.name}")
    text = reader.read_text().replace("density: 2500 kg/m^3, ", "")
    reader.write_text(re.sub(r"^contact:.*\n", "", text, flags=re.MULTILINE))
    width = density["high"] - density["low"]
    assert load(reader).points[0].scene.grains.density == pytest.approx(density["median"], abs=width / 50)


@pytest.mark.slow
def test_the_report_has_the_posterior(calibrated):
    _, options, _ = calibrated
    folder = options[1] / "reports/glass-friction"
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert (folder / "posterior.png").exists()
    for words in ("Calibration", "Material card", "Promise"):
        assert words in page


@pytest.mark.ring
def test_a_stopped_campaign_goes_on_with_the_same(calibrated, tmp_path):
    """A8: stopped after some runs, then made by another process: proposals and keys of runs are those of one go."""
    path, options, _ = calibrated
    whole = LabFolder(options[1])
    definition = load(path)

    class Stopping(Backend):
        opened = 0

        def open(self, *arguments, **keys):
            Stopping.opened += 1
            if Stopping.opened > 3:
                raise KeyboardInterrupt
            return super().open(*arguments, **keys)

    with suppress(KeyboardInterrupt):
        Runner(definition, LabFolder(tmp_path / "lab"), Stopping()).run()
    carry_out(definition, tmp_path / "lab")
    (kept,), (again,) = (sorted(place.campaigns.glob("*.json")) for place in (whole, LabFolder(tmp_path / "lab")))
    assert kept.read_text() == again.read_text()
    runs = [{one.name for one in (place.folder / "runs").iterdir()} for place in (whole, LabFolder(tmp_path / "lab"))]
    assert runs[0] == runs[1]


def test_a_study_without_parameters_is_refused(tmp_path):
    ended = labbook("calibrate", study_file(tmp_path), "--lab", tmp_path / "lab", "--backend", "toy", check=False)
    assert ended.exit_code == 1
    assert "has no `calibrate` section; the effect of numerics is measured by labbook pilot" in ended.output


def test_results_of_another_study_have_no_posterior(tmp_path):
    (tmp_path / "lab").mkdir()
    with pytest.raises(NoPosterior, match="has no parameters to calibrate"):
        Lab(tmp_path / "lab", "toy").results(load(study_file(tmp_path)), False).calibration()


def test_without_the_extra_the_remedy_is_told_before_anything_runs(tmp_path, monkeypatch):
    goal = "adapt: {map: {flow_rate: 5 %, over: [container.orifice]}}"
    monkeypatch.setattr("labbook.stats.emulator.find_spec", lambda module: None)
    for verb in ("plan", "run"):
        ended = labbook(verb, study_file(tmp_path, goal), "--lab", tmp_path / "lab", "--backend", "toy", check=False)
        assert ended.exit_code == 1
        assert "emulators need the package scikit-learn: pip install 'labbook[learn]'" in ended.output
