"""What is shown of a comparison: tables, figure, recording."""

import importlib.util
import math

import numpy as np
import pytest
from labbook_toy import Backend, Twin
from toy_lab import carry_out, study

from labbook.checks.compare.lockstep import record
from labbook.checks.compare.shown import contrast_table, cost_table, divergence_table, figure, summary
from labbook.checks.compare.sides import Side
from labbook.checks.compare.verdict import Contrast, Cost, Divergence, Entrant, PointVerdict, Verdict
from labbook.export.entities import CLOCK
from labbook.export.frames import FRAMES
from labbook.lab import LabFolder
from labbook.report.style import encode


def contrast(finding, difference=0.01, reach=0.015, **more) -> Contrast:
    numbers = {"difference": difference, "error": reach / 2, "low": difference - reach, "high": difference + reach}
    given = {"quantity": "flow_rate", "unit": "kg/s", "paired": True, "seeds": (1, 2), "finding": finding}
    given |= {"first": (0.05, 0.052), "second": (0.051, 0.052), "p": 0.02, "power": 0.8, **more}
    return Contrast.model_validate({**given, **numbers} if finding != "untested" else {**given, "note": "why not"})


def verdict(*findings, needed: int | None = 12) -> Verdict:
    entrants = tuple(Entrant(name=name, cache_version=1, device="cpu") for name in ("toy", "twin"))
    drift = Divergence(
        key="0" * 24,
        seed=1,
        time=(0.0, 0.01, 0.02),
        median=(0.0, 1e-8, 1e-4),
        largest=(0.0, 1e-6, 1.2),
        agree_until=0.01,
        ended="diverged",
        rates=(2e6, 4e6),
    )
    points = tuple(
        PointVerdict(
            index=k,
            label=f"orifice {18 + k} mm",
            runs=(("a",), ("b",)),
            contrasts=(contrast(found, 0.06 if found == "different" else 0.01, replicates_needed=needed),),
            divergence=drift if k else None,
        )
        for k, found in enumerate(findings)
    )
    costs = tuple(
        Cost(backend=one.name, devices=("cpu",), runs=2, wall_time=10.0, rate=3e6, session_wall=None)
        for one in entrants
    )
    return Verdict.model_validate(
        {
            "study": "toy-study",
            "made": "2026-01-01T00:00:00+00:00",
            "entrants": entrants,
            "measures": {"flow_rate": 1},
            "margin": 0.03,
            "alpha": 0.05,
            "replicates": 2,
            "points": points,
            "costs": costs,
        }
    )


@pytest.mark.parametrize(
    ("findings", "whole", "said"),
    [
        (("equivalent", "equivalent"), "equivalent", "equivalent within 3 % in all 2 tests"),
        (("equivalent", "undecided"), "undecided", "shown in 1 of 2 tests"),
        (("equivalent", "untested"), "undecided", "shown in 1 of 2 tests"),
        (("different", "undecided"), "different", "DIFFERENT by more than 3 % in 1 of 2 tests"),
    ],
)
def test_the_whole_follows_from_its_parts(findings, whole, said):
    made = verdict(*findings)
    assert made.finding == whole
    assert said in summary(made)[0]


def test_what_would_decide_is_said_if_something_is_undecided():
    assert "12 replicates would decide" in summary(verdict("undecided"))[1]
    assert "more than 1000 replicates" in summary(verdict("undecided", needed=None))[1]
    assert len(summary(verdict("equivalent"))) == 1


def test_tables_have_every_point_and_mark_differences():
    made = verdict("equivalent", "different", "untested")
    means = contrast_table(made)
    assert [row[-1] for row in means.rows] == ["equivalent", "different", "untested"]
    assert means.marked == {1}
    assert means.rows[0][4:8] == ("51", "51.5", "+1.00 %", "−0.50 % to +2.50 %")
    assert any("why not" in note for note in means.notes)
    apart = divergence_table(made)
    assert [row[1] for row in apart.rows] == ["–", "0.01", "0.01"]
    assert [row[-1] for row in cost_table(made).rows] == ["2.00", "4.00"]
    assert all(len(row) == len(table.headings) for table in (means, apart, cost_table(made)) for row in table.rows)


def test_the_figure_shows_means_margin_and_drift():
    made = verdict("equivalent", "different", "untested")
    drawn = figure(made)
    left, right = drawn.axes
    assert left.get_yscale() == "log"
    drift = [np.asarray(line.get_ydata()) for line in left.lines if line.get_linestyle() == "-"]
    assert any(np.array_equal(values, [1e-6, 1.2]) for values in drift)
    points = [container[0].get_xydata()[0] for container in right.containers]
    np.testing.assert_allclose(points, [[1, 0], [6, 1]])
    assert [label.get_text() for label in right.get_yticklabels()] == [f"W, orifice {d} mm" for d in (18, 19, 20)]
    assert encode(drawn, "svg") == encode(figure(made), "svg")


@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="rerun is not installed")
def test_a_recording_has_both_backends_on_one_clock(tmp_path):
    from rerun.chunk import RrdReader

    asked, lab = study(tmp_path, orifices="[24]"), tmp_path / "lab"
    carry_out(asked, lab)
    two = Side(Backend(), "cpu"), Side(Twin(bias=0.5), "cpu")
    path = record(asked, asked.points[0], LabFolder(lab), two, 0.05, tmp_path / "both.rrd")
    assert [entry.name for entry in tmp_path.glob("*.rrd")] == ["both.rrd"]
    assert path == tmp_path / "both.rrd"
    frames = {}
    for chunk in RrdReader(str(path)).stream():
        if not chunk.is_static and chunk.entity_path.endswith("/grains"):
            batch = chunk.to_record_batch()
            clock, cells = (batch.column(batch.schema.names.index(one)) for one in (CLOCK, "Points3D:positions"))
            times = clock.to_numpy(zero_copy_only=False).astype(float) * 1e-9
            counts = (len(one.as_py()) for one in cells)
            frames.setdefault(chunk.entity_path, {}).update(zip(times, counts, strict=True))
    assert set(frames) == {"/toy/grains", "/twin/grains"}
    for counts in frames.values():  # the packing comes first
        np.testing.assert_allclose(sorted(counts), np.linspace(0, 0.05, FRAMES + 1), atol=1e-8)
        assert counts[0] == 200
    assert sorted(frames["/toy/grains"]) == sorted(frames["/twin/grains"])
    left = {name: 200 - min(counts.values()) for name, counts in frames.items()}
    assert left["/twin/grains"] == pytest.approx(1.5 * left["/toy/grains"], abs=math.sqrt(left["/toy/grains"]))
