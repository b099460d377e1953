"""A study that is right, for tests that make it wrong, and the problems that are told of it then."""

from pathlib import Path

import pytest

from labbook.study import Problem, StudyError, load

BASE = """name: base
grains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 3000}
contact: {law: hertz-mindlin, shear_modulus: 100 MPa, poisson_ratio: 0.25, friction: 0.5, restitution: 0.2}
container:
  kind: wedge-hopper
  width: 100 mm
  height: 400 mm
  thickness: 1.01 d
  angle: 90 deg
  orifice: 30 mm
"""


def problems(tmp_path: Path, text: str) -> tuple[Problem, ...]:
    file = tmp_path / "study.yaml"
    file.write_text(text)
    with pytest.raises(StudyError) as caught:
        load(file)
    for problem in caught.value.problems:
        assert problem.file == file
        assert problem.message
        assert problem.remedy
    return caught.value.problems
