"""What `labbook plan` prints."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from labbook.cli import build
from labbook.cli.plan import spans

STUDIES = Path(__file__).parents[2] / "studies"


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
