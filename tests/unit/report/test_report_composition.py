"""Composition of the outflow in frames, of a mixture of the toy backend; `test_docs_recipes` has the report."""

import numpy as np
import pytest
from toy_lab import STUDY, carry_out

from labbook.api import Lab
from labbook.study import load

MIXTURE = (
    STUDY.format(count=1000, orifices="[24]", replicates=2)
    .replace("count: 1000}", "count: 1000, kinds: [{name: large, share: 25 %}, "
             "{name: small, share: 75 %, diameter: 2 mm}]}")
    .replace("measure: [flow_rate]", "measure: [flow_rate, composition]\nwindow: {start: 0.15, end: 0.6}\n"
             "stop: {discharged: 1}\n")
)  # fmt: skip


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mixture")
    (folder / "mixture.yaml").write_text(MIXTURE, encoding="utf-8")
    carry_out(load(folder / "mixture.yaml"), folder / "lab")
    return Lab(folder / "lab", backend="toy").results(load(folder / "mixture.yaml"), progress=False)


@pytest.mark.slow
def test_frames_have_kinds_and_shares_that_add_up(results):
    frame = results.frames()["composition"]
    assert list(frame["kind"].unique()) == ["large", "small"]
    shares = frame.pivot(index="from", columns="kind", values="share")
    assert shares.sum(axis=1).to_numpy() == pytest.approx(np.ones(len(shares)))
    assert frame["to"].max() == pytest.approx(1), "every grain of a full discharge is in a bin"
    large = frame[frame["kind"] == "large"]
    over = (large["share"] * (large["to"] - large["from"])).sum()
    # to second order in the differences between beds, of which shares and bins are means
    assert over == pytest.approx(large["initial"].iloc[0], rel=1e-3)
    assert (frame["counting_error"] > 0).all()
    assert "composition" in results.figures()
    crossing = results.run(1, seed=1).frame("crossing")
    assert set(crossing["kind"]) == {"large", "small"}
    assert crossing.attrs["units"]["radius"] == "m"
    assert sum(results.points[0].pooled[f"flow_rate_of_{kind}"].value for kind in ("large", "small")) == pytest.approx(
        results.points[0].pooled["flow_rate"].value
    )
