"""Ledgers of runs: the balance of their grains, what makes a run suspect, and where a suspect run counts."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from labbook_toy import Glass
from toy_lab import carry_out, labbook, study, study_file, unsealed
from toy_records import records
from toy_results import analyse

from labbook.backend import Status
from labbook.checks.verify.moving import box
from labbook.lab import Catalogue, RunRecord
from labbook.lab.packings import PackingRecord
from labbook.lab.records import RunLedger
from labbook.lab.suspect import DEEPEST, FASTEST, counts, said, suspicion
from labbook.plan.coverage import finished
from labbook.report.result_box import concerns
from labbook.run.ledger import expected_speed, inside_moving, ledger
from labbook.scene import (
    CylinderSilo,
    HertzMindlin,
    Packing,
    PartMotion,
    PartRotation,
    Primitives,
    Scene,
    Spheres,
    TriangleMesh,
    Wall,
    WedgeHopper,
)
from labbook.scene.triangles import Triangles

D, G = 3e-3, 9.81
BACKEND = ("--backend", "toy")
GOOD = RunLedger(overlap=0.02, speed=1.0, expected_speed=1.0, started=10, inside=4, left=6, outside=0)


def scene(container) -> Scene:
    law = HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25, friction=0.5)
    return Scene(grains=Spheres(diameter=D, density=2500, count=10), contact=law, container=container, gravity=G)


HOPPER = scene(WedgeHopper(width=0.06, height=0.2, thickness=1.01 * D, orifice=0.024))


def packing(*x: tuple[float, float], ids=None) -> Packing:
    at = np.array([(a, 0.0, c) for a, c in x], float).reshape(-1, 3)
    return Packing(x=at, v=np.zeros_like(at), omega=np.zeros_like(at), ids=np.arange(len(at)) if ids is None else ids)


def crossed(*rows: tuple[int, float]) -> dict[str, np.ndarray]:
    ids, x = (np.array(column) for column in zip(*rows, strict=True))
    return {"id": ids, "x": x, "y": np.zeros(len(x)), "z": np.full(len(x), -1e-5)}


START = packing(*((-0.02 + 0.004 * k, 0.01 * (k + 1)) for k in range(10)))
NOW = Status(100, 1e-3, 5, 0.0, 0.02, 1.3)


def balance(end: Packing, *rows: tuple[int, float]) -> tuple[int, int, int, int]:
    found = ledger(HOPPER, NOW, end, START, crossed(*rows) if rows else None)
    assert (found.overlap, found.speed, found.started) == (0.02, 1.3, 10)
    return found.inside, found.left, found.outside, found.lost


def test_grains_that_leak_out_of_a_part_that_moves_are_outside():
    """A cube of sides of 0.2 m that turns about y by an eighth: its corners reach out there, and its sides no more."""
    surface, _ = Triangles.welded(*box(0.1))
    turned = PartRotation(axis=(0.0, 1.0, 0.0), rate=math.pi / 4)
    cube = Wall(name="cube", shape=TriangleMesh.of_surface(surface, encloses=True), moves=PartMotion(rotation=turned))
    of = scene(Primitives(parts=(cube,)))
    end = packing((0.0, 0.0), (0.13, 0.0), (0.08, 0.08))
    for time, outside in ((0.0, 1), (1.0, 1)):
        assert ledger(of, replace(NOW, time=time), end).outside == outside
    assert inside_moving(of, end.x, 0.0).tolist() == [True, False, True]
    assert inside_moving(of, end.x, 1.0).tolist() == [True, True, False]
    lid = cube.model_copy(update={"opens": 0.5})
    assert inside_moving(scene(Primitives(parts=(lid,))), end.x, 1.0).all(), "what has vanished holds nothing"


def test_every_grain_is_inside_left_or_outside():
    stay = [(0.0, 0.01 * (k + 1)) for k in range(4)]
    gone = [(k, 0.01 * math.sin(k)) for k in range(4, 10)]
    assert balance(packing(*stay), *gone) == (4, 6, 0, 0)
    falling = packing(*stay, (0.0, -0.004), ids=np.array([0, 1, 2, 3, 9]))  # has left, and is not dropped yet
    assert balance(falling, *gone) == (4, 6, 0, 0)


def test_a_grain_that_got_behind_a_wall_is_outside():
    inside = [(0.0, 0.01 * (k + 1)) for k in range(9)]
    assert balance(packing(*inside, (0.0301, 0.05))) == (9, 0, 1, 0)
    assert balance(packing(*inside), (9, 0.0121)) == (9, 0, 1, 0), "below the bottom beside the outlet"
    assert balance(packing(*inside), (9, -0.0119)) == (9, 1, 0, 0)


def test_a_grain_of_which_nobody_knows_is_lost():
    assert balance(packing(*[(0.0, 0.01 * (k + 1)) for k in range(4)]), (4, 0.0)) == (4, 1, 0, 5)
    sunk = packing((0.0, -0.004), *[(0.0, 0.01 * (k + 1)) for k in range(9)])
    assert balance(sunk) == (9, 0, 0, 1), "below the outlet without having passed it"


def test_a_grain_that_came_back_is_inside():
    inside = [(0.0, 0.01 * (k + 1)) for k in range(10)]
    assert balance(packing(*inside), (3, 0.0), (3, 0.001), (4, 0.0)) == (10, 0, 0, 0)


def test_a_filling_starts_with_all_grains_and_expects_no_speed():
    found = ledger(HOPPER.close(), NOW, packing(*[(0.0, 0.01 * (k + 1)) for k in range(10)]))
    assert (found.started, found.inside, found.left, found.outside, found.lost) == (10, 10, 0, 0, 0)
    assert found.expected_speed is None


def test_the_expected_speed_is_that_of_a_free_fall_and_of_the_walls():
    assert expected_speed(HOPPER, START) == pytest.approx(math.sqrt(2 * G * (0.1 + 5 * D)))
    turning = scene(CylinderSilo(diameter=0.06, height=0.2, orifice=0.024, rotation=0.5))
    assert expected_speed(turning, START) == pytest.approx(math.sqrt(2 * G * (0.1 + 5 * D)) + math.pi * 0.02)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({}, ""),
        ({"overlap": DEEPEST}, ""),
        ({"overlap": 0.123}, "grains overlap by 0.123 d, more than 0.1 d"),
        ({"speed": FASTEST}, ""),
        ({"speed": 3.2}, "a grain moves at 3.2 m/s, more than 3 times its free-fall speed"),
        ({"speed": 3.2, "expected_speed": None}, ""),
        ({"overlap": None, "speed": None}, ""),
        ({"inside": 3, "outside": 1}, "1 grain went through a wall or past the outlet"),
        ({"left": 5}, "the number of grains is not conserved: 10 = 4 inside + 5 left + 0 outside fails by 1"),
        ({"overlap": 0.2, "inside": 2, "outside": 2},
         "grains overlap by 0.2 d, more than 0.1 d; 2 grains went through a wall or past the outlet"),
    ],
)  # fmt: skip
def test_what_makes_a_run_suspect(change, why):
    assert suspicion(GOOD.model_copy(update=change)) == why


def test_of_a_run_without_a_ledger_nothing_is_suspected():
    assert suspicion(None) == ""
    assert said(None) == "not kept"


def test_who_counts():
    assert [counts("finished", "", one) for one in (False, True)] == [True, True]
    assert [counts("finished", "why", one) for one in (False, True)] == [False, True]
    assert [counts("diverged", "", one) for one in (False, True)] == [False, False]


def test_runs_and_packings_keep_their_ledgers_and_keys_know_nothing_of_them(tmp_path):
    carry_out(study(tmp_path, replicates=1, orifices="[24]"), tmp_path / "lab")
    (record,) = records(tmp_path / "lab").values()
    kept, coverage = record.ledger, record.coverage
    assert kept is not None
    assert (kept.started, kept.left, kept.outside, kept.lost) == (coverage.grains, coverage.crossed, 0, 0)
    assert (kept.overlap, kept.speed) == (None, None), "the toy backend does not tell"
    (folder,) = (tmp_path / "lab/packings").iterdir()
    packed = PackingRecord.read(folder).ledger
    assert packed is not None
    assert packed.inside == packed.started == 200
    older = {name: value for name, value in json.loads(record.as_stored()).items() if name != "ledger"}
    again = RunRecord.model_validate(older)
    assert again.ledger is None
    assert json.loads(again.as_stored()) == older


def marred(lab, seed: int, orifice: int = 24) -> None:
    """Let the run of a seed have overlapped by a fifth of d."""
    file = lab / "runs" / records(lab)[f"orifice {orifice} mm", seed].run_key / "run.json"
    text = unsealed(file.read_text())
    assert text.count('"overlap": null') == 1
    file.write_text(text.replace('"overlap": null', '"overlap": 0.2'))


def test_a_suspect_run_is_no_replicate_whose_flow_rate_counts(tmp_path):
    """As for runs that diverged: another one is made in its place, and the rule and the report pool the same runs."""
    lab, rule = tmp_path / "lab", "accuracy: {flow_rate: 70 %, max_replicates: 8}"
    asked = study(tmp_path, rule, replicates=2, orifices="[24]")
    assert len(carry_out(asked, lab).tally.ran) == 5
    marred(lab, 2)
    summary = carry_out(asked, lab)
    assert len(summary.tally.ran) == 1
    assert not summary.complete
    (point,) = summary.points
    assert point.decision is not None
    (found,) = analyse(asked, finished(Catalogue(lab), asked, "toy")).points
    assert found.flow_rate == point.decision.pooled
    assert found.flow_rate is not None
    assert found.flow_rate.n == 5
    assert found.remark == "1 of 6 suspect"


def test_a_study_may_count_them_all_the_same(tmp_path):
    lab, sizes = tmp_path / "lab", {"replicates": 3, "orifices": "[24]"}
    carry_out(study(tmp_path, **sizes), lab)
    marred(lab, 2)
    for line, n, fate in (("", 2, "left out"), ("accuracy: {count_suspect: true}", 3, "counted all the same")):
        asked = study(tmp_path, line, **sizes)
        summary = carry_out(asked, lab)
        assert not summary.tally.ran
        assert summary.complete == (n == 3)
        results = analyse(asked, finished(Catalogue(lab), asked, "toy"))
        (point,) = results.points
        assert point.flow_rate is not None
        assert point.flow_rate.n == n
        assert [run.seed for run in point.suspect] == [2]
        (told,) = (one for one in concerns(results) if "suspect" in one)
        assert told.startswith(f"1 run is suspect and {fate}")
        assert "D = 24 mm, seed 2: grains overlap by 0.2 d, more than 0.1 d" in told


def test_every_verb_says_which_run_is_suspect_and_why(tmp_path):
    path, lab = study_file(tmp_path), tmp_path / "lab"
    labbook("run", path, "--lab", lab, *BACKEND)
    marred(lab, 1)
    why = "grains overlap by 0.2 d, more than 0.1 d"
    ended = labbook("run", path, "--lab", lab, *BACKEND, check=False)
    assert ended.exit_code == 1
    assert "4 of 4 runs done" in ended.stdout
    assert f"Suspect: orifice 24 mm, seed 1: {why}; left out of every mean" in ended.stdout
    assert f"labbook runs --outcome suspect --lab {lab}" in ended.stdout
    (row,) = json.loads(labbook("runs", "--outcome", "suspect", "--lab", lab, "--json").stdout)
    assert (row["seed"], row["outcome"], row["suspect"]) == (1, "finished", why)
    shown = labbook("runs", "--lab", lab).stdout
    assert "finished, suspect" in shown
    assert f"{row['run_key'][:10]} is suspect: {why}" in shown
    assert f"suspect: {why}" in labbook("show", row["run_key"], "--lab", lab).stdout
    assert "1 run is suspect" in labbook("status", "--lab", lab).stdout
    assert json.loads(labbook("status", "--lab", lab, "--json").stdout)["suspect"] == 1
    labbook("reindex", "--lab", lab)
    assert "1 run is suspect" in labbook("status", "--lab", lab).stdout


def test_grains_that_leak_through_the_bottom_are_noticed(tmp_path, monkeypatch):
    """Found from where grains pass the plane of the outlet: at the end they have long been dropped."""
    monkeypatch.setattr(Glass, "exit_point", lambda glass, x: (0.029, 0.0))
    summary = carry_out(study(tmp_path, replicates=1, orifices="[24]"), tmp_path / "lab")
    (record,) = records(tmp_path / "lab").values()
    many = record.coverage.crossed
    told = f"{many} grains went through a wall or past the outlet"
    assert summary.suspect == {"orifice 24 mm": {1: told}}
