"""The recipe on clogging of docs/howto.md, from its YAML to its tables, on the toy backend."""

import re
from pathlib import Path

import pytest
from labbook_toy import Backend
from toy_lab import carry_out

from labbook.cli.work import fit
from labbook.lab import Catalogue
from labbook.results.clogging import clogging
from labbook.results.find import find
from labbook.stats.rates import PooledRate, events_needed
from labbook.study import load

HOWTO = (Path(__file__).parents[3] / "docs" / "howto.md").read_text(encoding="utf-8")


def recipe(title: str) -> str:
    """The first YAML block of a section."""
    section = HOWTO.split(f"\n## {title}\n")[1].split("\n## ")[0]
    found = re.search(r"```yaml\n(.*?)```", section, re.DOTALL)
    assert found is not None
    return found[1]


@pytest.mark.slow
def test_clogging_from_yaml_to_its_tables(tmp_path, capsys):
    """The probability is that of the backend at each outlet. Fewer stops than in the recipe are requested."""
    path = tmp_path / "my-clogging.yaml"
    path.write_text(recipe("Measure clogging"))
    quick = {"grains.count": 60, "replicates": 2, "accuracy.clogging": "50 %", "stop.max_time": "4 s"}
    study = load(path).change({"numerics.precision": "double", "numerics.steps_per_beat": 4000, **quick})
    true = {2.5: 1 / 6, 3.0: 1 / 12, 3.5: 1 / 24}
    carry_out(study, tmp_path / "lab", backend=Backend(clogs=lambda ratio: true[round(ratio, 3)]))
    results = find(study, Catalogue(tmp_path / "lab"), "toy")
    (series,) = clogging(results)
    for point in series.points:
        q = point.probability
        assert isinstance(q, PooledRate)
        assert q.events >= events_needed(0.5) or len(point.result.beds) == 12
        assert q.low * 0.9 < true[round(point.width_ratio, 3)] < q.high * 1.1
    fit.show(results, as_json=False)  # pyright: ignore[reportArgumentType]
    printed = capsys.readouterr().out
    assert "mean avalanche" in printed
    assert "No critical size" in printed
