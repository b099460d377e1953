"""Remedies that name what a study's author meant: words of other codes, keys by their last word, and limits."""

import re
import sys
import time

import pytest
from wrong_study import BASE, problems

from labbook.scene.quantities import parse
from labbook.study import StudyError, load
from labbook.study.problems import MAX_PRINTED, Problem


def told(tmp_path, text, key):
    return next(problem for problem in problems(tmp_path, text) if problem.key == key)


HERTZ = "shear_modulus: 100 MPa, poisson_ratio: 0.25"


@pytest.mark.parametrize(
    ("old", "new", "key", "remedy"),
    [
        (HERTZ, "young_modulus: 5 MPa, poisson_ratio: 0.25", "contact.young_modulus", "write youngs_modulus"),
        (HERTZ, "E: 5 MPa, poisson_ratio: 0.25", "contact.E", "write youngs_modulus"),
        (HERTZ, "youngsModulus: 5e6, poisson_ratio: 0.25", "contact.youngsModulus", "write youngs_modulus"),
        ("name: base", "name: base\nwalls: {bottom: {E: 5 MPa}}", "walls.bottom.E", "write youngs_modulus"),
        ("name: base", "name: base\nyoung: 5 MPa", "young", "write contact: {youngs_modulus: ...}"),
        ("restitution: 0.2", "coefficient_of_restitution: 0.2", "contact.coefficient_of_restitution", "restitution"),
        ("restitution: 0.2", "restitution: 0.2, mu: 0.5", "contact.mu", "write friction"),
        ("restitution: 0.2", "restitution: 0.2, rolling_damping: 1", "contact.rolling_damping", "rolling_model: epsd"),
        ("restitution: 0.2", "restitution: 0.2, eta_r: 0.3", "contact.eta_r", "write rolling_damping"),
        ("diameter: 3 mm", "radius: 1.5 mm", "grains.radius", "diameter: 3 mm"),
        ("count: 3000", "n: 3000", "grains.n", "write count"),
        ("count: 3000", "number: 3000", "grains.number", "write count"),
        ("name: base", "name: base\ntimestep: 1 us", "timestep", "numerics: {dt: ...}"),
        ("name: base", "name: base\ndt: 1 us", "dt", "numerics: {dt: ...}"),
        ("name: base", "name: base\nnumerics: {time_step: 1 us}", "numerics.time_step", "write dt"),
        ("name: base", "name: base\nperiodic: true", "periodic", "periodic: y"),
        ("name: base", "name: base\nfriction: 0.5", "friction", "contact.friction"),
        ("name: base", "name: base\nmeasures: [flow_rate]", "measures", "did you mean measure?"),
        ("orifice: 30 mm", "outlet: 30 mm", "container.outlet", "write orifice"),
        ("orifice: 30 mm", "orifice: 30 mm\n  radius: 30 mm", "container.radius", "known here: angle"),
        ("name: base", "name: base\nwalls: {bottom: {mu: 0.1}}", "walls.bottom.mu", "write friction"),
        ("name: base", "study: base", "study", "write name"),
    ],
)
def test_words_of_other_codes(tmp_path, old, new, key, remedy):
    assert BASE.count(old) == 1
    assert remedy in told(tmp_path, BASE.replace(old, new), key).remedy


def test_a_radius_is_told_once(tmp_path):
    (problem,) = problems(tmp_path, BASE.replace("diameter: 3 mm", "radius: 1.5 mm"))
    assert problem.remedy == "write diameter: 3 mm"


def test_a_container_too_narrow_for_a_grain_gets_a_width_that_is_taken(tmp_path):
    narrow = BASE.replace("1.01 d", "0.5 d")
    (problem,) = problems(tmp_path, narrow)
    (enough,) = re.findall(r"make it (\S+ mm) \(1.01 d\) or more", problem.remedy)
    path = tmp_path / "enough.yaml"
    path.write_text(narrow.replace("0.5 d", enough))
    assert load(path)


def test_a_misnamed_modulus_is_told_once(tmp_path):
    (problem,) = problems(tmp_path, BASE.replace(HERTZ, "young_modulus: 5 MPa, poisson_ratio: 0.25"))
    assert problem.key == "contact.young_modulus"


@pytest.mark.parametrize(
    ("key", "remedy"),
    [
        ("friction", "did you mean contact.friction? There are also walls.NAME.friction and fill.friction"),
        ("mu", "did you mean contact.friction?"),
        ("walls.bottom.mu", "did you mean walls.bottom.friction?"),
        ("grains.radius", "did you mean grains.diameter?"),
        ("radius", "write diameter, twice the radius"),
        ("orifice", "did you mean container.orifice?"),
        ("container", "container is a section: name one of its keys, such as container."),
        ("container.orifce", "did you mean container.orifice?"),
        ("gravitas", "did you mean gravity?"),
        ("timestep", "did you mean numerics.dt?"),
        ("zzz", "write a key of docs/studies.md"),
    ],
)
def test_what_a_sweep_seems_to_mean(tmp_path, key, remedy):
    (problem,) = problems(tmp_path, f"{BASE}sweep: {{{key}: [1, 2]}}\n")
    assert problem.message == "there is no such key"
    assert remedy in problem.remedy
    assert len(problem.remedy) < 120


@pytest.mark.parametrize("key", ["friction", "orifice", "gravitas", "container"])
def test_references_are_helped_as_sweeps_are(tmp_path, key):
    text = f"{BASE}reference: {{source: x, flow_rate: {{value: 1 kg/s, at: {{{key}: 1}}}}}}\n"
    (problem,) = problems(tmp_path, text)
    assert "there is no such key" in problem.message
    assert len(problem.remedy) < 120


@pytest.mark.parametrize(
    ("text", "unit", "write"),
    [
        ("2500 kg/m3", "kg/m^3", "write kg/m^3"),
        ("2500 kg/m³", "kg/m^3", "write kg/m^3"),
        ("2500 kg/m^-3", "kg/m^3", "write kg/m^3"),
        ("2500 kg m-3", "kg/m^3", "write kg m^-3"),
        ("9.81 m/s2", "m/s^2", "write m/s^2"),
    ],
)
def test_powers_that_are_misspelled(text, unit, write):
    with pytest.raises(ValueError, match=write.replace("^", r"\^")):
        parse(text, unit)
    corrected = f"{text.split()[0]} {write.removeprefix('write ')}"
    assert parse(corrected, unit) == float(text.split()[0])


def test_units_of_another_kind_get_no_such_hint():
    with pytest.raises(ValueError, match=r"not one in kg$"):
        parse("3 kg", "kg/s")


@pytest.mark.parametrize(
    ("old", "new", "line", "key", "message", "remedy"),
    [
        ("name: base", "name: base\ngravity: 0 m/s^2", 2, "gravity", "do not settle", "above 0"),
        (
            "thickness: 1.01 d\n  angle: 90 deg\n  orifice: 30 mm",
            "thickness: 2.5 d\n  orifice: 30 mm\nfill: {kind: planar}",
            8,
            "container.thickness",
            "there is room for more (2.5 d)",
            "less than 2 d",
        ),
        ("1.01 d", "1 d", 8, "container.thickness", "leaves no room", "1.01 d or more"),
        ("30 mm", "30 mm\nstop: {fill_height: 10 m}", 11, "stop.fill_height", "10000 mm is above any bed", "less than"),
        ("30 mm", "30 mm\nreplicates: 99999", 11, "replicates", "at most 10000", "at least 1, and at most 10000"),
        ("name: base", "name: ba\0se", 1, "", "not valid YAML", "remove the character 0x00 on line 1"),
        ("30 mm", "30 mm\npoints: [{}]", 11, "points[0]", "empty", "`container.orifice: 30 mm`"),
        (
            "30 mm",
            "30 mm\nsweep:\n  walls.roof.friction: [1]",
            12,
            "walls.roof",
            "no wall named roof",
            "use one of: all",
        ),
    ],
)
def test_messages_have_place_key_and_remedy(tmp_path, old, new, line, key, message, remedy):
    (problem,) = problems(tmp_path, BASE.replace(old, new))
    assert (problem.line, problem.key) == (line, key)
    assert message in problem.message
    assert remedy in problem.remedy


def test_swept_values_that_cannot_be_filled_are_told_at_their_line(tmp_path):
    text = BASE + 'sweep:\n  gravity: ["0 m/s^2", "9.81 m/s^2"]\n'
    (problem,) = problems(tmp_path, text)
    assert (problem.line, problem.key) == (12, "gravity")
    assert "(at gravity 0 m/s^2)" in problem.message


def test_of_many_problems_the_first_are_printed(tmp_path):
    found = [Problem(tmp_path, n, f"k{n}", "wrong", "right") for n in range(1, MAX_PRINTED + 6)]
    lines = str(StudyError(found)).splitlines()
    assert len(lines) == 2 * MAX_PRINTED + 1
    assert lines[-1] == "and 5 more problems"
    assert len(StudyError(found).problems) == MAX_PRINTED + 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("points: [" + ",".join(["1"] * 900_000) + "]\n", "more than 100000 values"),
        ("".join(f"k{n}: 1\n" for n in range(40_000)), "unknown key"),
        ("fill:\n" + "".join(f"  k{n}: 1\n" for n in range(40_000)), "unknown key"),
    ],
)
def test_huge_files_are_refused_in_seconds(tmp_path, text, message):
    """They took more than a minute. Processor time, so that other work on the machine does not count."""
    began = time.process_time()
    (problem, *_) = problems(tmp_path, BASE + text)
    assert message in problem.message
    assert time.process_time() - began < 25


def test_more_runs_than_a_plan_holds_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules["labbook.study.load"], "MAX_RUNS", 5)  # `load` is the function, too
    text = BASE + 'sweep: {container.orifice: "[20, 30] mm"}\nreplicates: 3\n'
    (problem,) = problems(tmp_path, text)
    assert (problem.line, problem.key) == (12, "replicates")
    assert "2 points of 3 replicates are 6 runs, more than 5" in problem.message
    assert "at most 2 replicates" in problem.remedy


@pytest.mark.slow
def test_points_cost_the_same_however_many_there_are(tmp_path):
    """10 000 points load in the time of 1000 times ten, and a half: quadratic they would take ten times that."""

    def seconds(n):
        widths = ", ".join(f"{18 + k / 1000:.3f}" for k in range(n))
        file = tmp_path / "many.yaml"
        file.write_text(f'{BASE}sweep: {{container.orifice: "[{widths}] mm"}}\n')
        began = time.process_time()
        assert len(load(file).points) == n
        return time.process_time() - began

    seconds(10)
    assert seconds(10_000) < 40 * max(seconds(1000), 0.05)


@pytest.mark.parametrize(
    ("key", "name"), [("contact", "friction"), ("fill", "fill.friction"), ("walls.all", "walls.all.friction")]
)
def test_labels_tell_frictions_apart(tmp_path, key, name):
    file = tmp_path / "study.yaml"
    file.write_text(f"{BASE}sweep: {{{key}.friction: [0.1, 0.2]}}\n")
    assert [point.label for point in load(file).points] == [f"{name} 0.1", f"{name} 0.2"]
