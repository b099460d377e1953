"""What `labbook plan` prints."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from labbook.cli import build
from labbook.cli.work.plan import spans

STUDIES = Path(__file__).parents[3] / "studies"


@pytest.mark.parametrize(
    ("seeds", "text"),
    [([], ""), ([4], "4"), ([1, 2], "1-2"), ([2, 1, 3], "1-3"), ([1, 2, 3, 5, 8, 9], "1-3, 5, 8-9")],
)
def test_seeds_are_named_in_few_words(seeds, text):
    assert spans(seeds) == text


def test_no_part_of_a_long_point_is_cut_off_on_a_narrow_terminal(tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    study = str(STUDIES / "pongo2022-aspect-ratio.yaml")
    shown = CliRunner().invoke(build(), ["plan", study, "--lab", str(tmp_path)])
    assert shown.exit_code == 0, shown.output
    assert "…" not in shown.output
    words = " ".join(shown.output.partition("fill steps")[0].split())
    for frequency in ("0", "0.16", "1.28"):
        assert words.count(f"rotation {frequency} Hz") == 6
    assert words.count("1-3 missing not run yet") == 36


def test_outlets_of_rods_and_spheres_are_measured_each_in_its_own_size(tmp_path):
    """22 mm are 5.4 diameters of a sphere of 4.071 mm, and 3.67 lengths of a rod of 6 mm."""
    path = tmp_path / "rods.yaml"
    path.write_text("""
name: rods
grains: {shape: spherocylinder, length: 6 mm, diameter: 3 mm, density: 2500 kg/m^3, count: 500}
contact: {law: linear, normal_stiffness: 2000 N/m, friction: 0.5, restitution: 0.5}
container: {kind: cylinder-silo, diameter: 60 mm, height: 200 mm, orifice: 22 mm}
sweep: {zip: {grains.length: [4.071 mm, 6 mm], grains.diameter: [4.071 mm, 3 mm]}}
replicates: 2
measure: [flow_rate]
""")
    shown = CliRunner().invoke(build(), ["plan", str(path), "--lab", str(tmp_path / "lab")])
    assert shown.exit_code == 0, shown.output
    assert "5.4 d" in shown.output
    assert "3.67 L" in shown.output
