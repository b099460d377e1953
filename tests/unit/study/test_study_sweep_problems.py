"""Sweeps and lists of points that are wrong: line, key, message and remedy of each problem."""

import pytest
from wrong_study import BASE, problems


@pytest.mark.parametrize(
    ("text", "line", "key", "message", "remedy"),
    [
        ("sweep: {container.orifise: [1 mm]}", 11, "sweep.container.orifise", "no such key", "container.orifice?"),
        ("sweep: {container.orifice: []}", 11, "sweep.container.orifice", "empty", "leave the key out"),
        ('sweep: {container.orifice: "[] mm"}', 11, "sweep.container.orifice", "empty", "leave the key out"),
        ("sweep: {}", 11, "sweep", "empty", "leave it out"),
        ("sweep: [1]", 11, "sweep", "a mapping of keys", "container.orifice"),
        ("sweep: {container.orifice: 20 mm}", 11, "sweep.container.orifice", "a list of values", "in quotes"),
        ("sweep: {container: [{}]}", 11, "sweep.container", "no such key", "container."),
        ("sweep: {replicates: [1, 2]}", 11, "sweep.replicates", "cannot vary", "two studies"),
        ("sweep: {container.orifice: [1 cm, 1 cm]}", 11, "sweep.container.orifice", "listed twice", "once"),
        ("sweep:\n  container.orifice:\n  - 20 mm\n  - 2 cm", 14, "container.orifice", "repeats the point", "leave"),
        ("sweep:\n  container.orifice:\n  - 20 mm\n  - 90", 14, "container.orifice", "unit is missing", "30 mm"),
        ("sweep:\n  container.orifice:\n  - 20 mm\n  - 1 m", 14, "container.orifice", "(at orifice 1 m)", "smaller"),
        ("sweep:\n  container.orifice: [[1 mm]]", 12, "sweep.container.orifice[0]", "a single value", "quantity"),
        ("sweep:\n  zip: {gravity: [1 m/s^2], grains.count: [1, 2]}", 12, "sweep.zip", "differ in length", "same"),
        ("sweep:\n  gravity: [1 m/s^2]\n  zip: {gravity: [2 m/s^2]}", 12, "sweep.gravity", "swept twice", "one"),
        ("points: []", 11, "points", "empty", "container.orifice"),
        ("points: [{}]", 11, "points[0]", "empty", "container.orifice"),
        ("points: [3]", 11, "points[0]", "a mapping of keys", "container.orifice"),
        ("points:\n- {gravity: 1 m/s^2}\n- {gravity: 1 m/s^2}", 13, "gravity", "repeats the point", "leave one"),
        ("points: [{gravity: 1 m/s^2}]\nsweep: {gravity: [2 m/s^2]}", 12, "sweep.gravity", "listed in points", "one"),
        ("points: [{gravitas: 1}]", 11, "points[0].gravitas", "no such key", "gravity?"),
        ("reference: 3", 11, "reference", "a mapping of keys", "source"),
        ("reference: {flow_rate: {value: 1 kg/s}}", 11, "reference.source", "missing", "paper"),
    ],
)
def test_problems_of_sweeps(tmp_path, text, line, key, message, remedy):
    (problem,) = problems(tmp_path, BASE + text + "\n")
    assert (problem.line, problem.key) == (line, key)
    assert message in problem.message
    assert remedy in problem.remedy


def test_a_problem_of_many_points_is_told_once(tmp_path):
    (problem,) = problems(tmp_path, BASE.replace("90 deg", "99 deg") + 'sweep: {container.orifice: "[20, 30] mm"}\n')
    assert "(at orifice 20 mm and 1 other point)" in problem.message


def test_a_huge_sweep_is_refused_at_once(tmp_path):
    values = ", ".join(f"{n} mm" for n in range(10, 60))
    keys = ("container.orifice", "container.gap", "container.thickness", "grains.diameter")
    text = "sweep:\n" + "".join(f"  {key}: [{values}]\n" for key in keys)
    (problem, *_) = [p for p in problems(tmp_path, BASE + text) if p.key == "sweep"]
    assert "6250000 points are more than 100000; a plan of them takes about 50 GB of memory" in problem.message
