"""The recipe on the outlet for a flow rate of docs/howto.md: study, commands and answer, on the toy backend."""

import re
import shlex
from pathlib import Path

import pytest
from toy_lab import labbook

HOWTO = (Path(__file__).parents[3] / "docs" / "howto.md").read_text(encoding="utf-8")
TITLE = "Find the outlet for a flow rate"


@pytest.mark.slow
def test_the_recipe_gives_the_outlet(tmp_path, monkeypatch):
    """With fewer grains and a stated step. The target is what the toy gives at an outlet of 18 mm."""
    section = HOWTO.split(f"\n## {TITLE}\n")[1].split("\n## ")[0]
    text = re.search(r"```yaml\n(.*?)```", section, re.DOTALL)
    assert text is not None
    text = (
        text[1].replace("count: 2000", "count: 500") + "numerics: {dt: 10 us, steps_per_beat: 200, precision: double}\n"
    )
    text += "window: {start: 0.15, end: 0.6}\n"
    (tmp_path / "probe.yaml").write_text(re.sub(r"adapt:.*?runs\n", "", text, flags=re.DOTALL) + "replicates: 2\n")
    monkeypatch.chdir(tmp_path)
    probe = (tmp_path / "probe.yaml").read_text().replace("outlet-for-50", "probe").replace("[15, 21]", "[18]")
    (tmp_path / "probe.yaml").write_text(probe)
    labbook("run", "probe.yaml", "--backend", "toy", "--lab", "probe")
    printed = labbook("fit", "probe.yaml", "--backend", "toy", "--lab", "probe").output
    found = re.search(r"W = ([\d.]+)", printed)
    assert found is not None
    target = float(found[1])
    (tmp_path / "outlet-for-50.yaml").write_text(text.replace("flow_rate: 50 g/s", f"flow_rate: {target} g/s"))
    lines = [line for block in re.findall(r"```sh\n(.*?)```", section, re.DOTALL) for line in block.splitlines()]
    outputs = {}
    for line in lines:
        words = [word.replace("45 g/s", f"{target} g/s") for word in shlex.split(line, comments=True)[1:]]
        outputs[words[0]] = labbook(*words, "--backend", "toy").output
    assert f"flow_rate = {target:.4g} g/s within 3 %" in outputs["plan"]
    assert "Promise kept (3 %)" in outputs["run"]
    answer = re.search(r"D = ([\d.]+) mm \(95 %: ([\d.]+) to ([\d.]+)\)", outputs["fit"])
    assert answer is not None
    value, low, high = map(float, answer.groups())
    assert low < value < high
    assert value == pytest.approx(18, rel=0.03)
    page = (tmp_path / "lab/reports/outlet-for-50/report.html").read_text(encoding="utf-8")
    assert "Promise kept (3 %)" in page
