"""What `labbook run` says at its end, with which exit status; and backends whose packages are missing."""

import json
import re
import sys

import labbook_toy
import pytest
from labbook_dem.ensemble import explain
from toy_lab import carry_out, labbook, study, study_file, unsealed
from toy_records import records

from labbook.backend import BackendMissing, Failed, load
from labbook.lab import RunRecord

BACKEND = ("--backend", "toy")


def test_a_study_that_is_complete_ends_with_what_to_do_next(tmp_path):
    path, lab = study_file(tmp_path), tmp_path / "my lab"
    ended = labbook("run", path, "--lab", lab, *BACKEND)
    assert ended.exit_code == 0
    assert ended.stdout.splitlines()[-1] == f"Next: labbook report {path} --lab '{lab}' --backend toy"
    study_file(tmp_path, "record: {every: 4 ms, replicates: 1}")
    *_, report, view = labbook("run", path, "--lab", lab, *BACKEND).stdout.splitlines()
    assert report.startswith("Next: labbook report")
    assert view.strip() == f"labbook view {path} --lab '{lab}' --backend toy"


def test_a_guard_says_by_how_much_it_failed_however_little(tmp_path):
    point = study(tmp_path).points[0]
    numerics = point.numerics.model_copy(update={"overlap_limit": 0.004, "speed_limit": 5.0})
    d = point.scene.grains.diameter
    assert "overlaps by 0.0040001 d, more than numerics.overlap_limit (0.004);" in explain(
        "overlap", 3, 100, 0.0040001 * d, point.scene, numerics
    )
    assert "moves at 5.002 m/s, faster than numerics.speed_limit (5 m/s);" in explain(
        "speed", 3, 100, 5.002, point.scene, numerics
    )


def test_a_run_that_diverged_is_named_each_time_with_exit_status_one(tmp_path):
    path, lab = study_file(tmp_path), tmp_path / "lab"
    for _ in range(2):
        ended = labbook("run", path, "--lab", lab, *BACKEND, check=False, LABBOOK_TOY_FAILS="18")
        assert ended.exit_code == 1
        assert "4 of 4 runs done" in ended.stdout
        assert "Diverged: orifice 18 mm, seeds 1, 2: stopped by a guard, and left out of every mean" in ended.stdout
        assert f"labbook runs --outcome diverged --lab {lab}" in ended.stdout
        assert "Next: labbook report" in ended.stdout
    listed = labbook("runs", "--outcome", "diverged", "--lab", lab, "--json").stdout
    assert len(json.loads(listed)) == 2, "the command that is named lists them"


class Failing(labbook_toy.Backend):
    """Every filling fails a guard at once."""

    def open(self, spec, slots=None, device="cpu"):
        ensemble = super().open(spec, slots, device)
        if spec.feature("closed"):
            said = "grain 45 at step 6 (0.06 ms, dt = 10 us) moves at 143 m/s"
            ensemble.advance = lambda beats=1: [
                Failed(member, "speed", 6, 45, said) for member in list(ensemble._glasses)
            ]
        return ensemble


def test_a_filling_that_fails_a_guard_says_so_in_words(tmp_path):
    lab = tmp_path / "lab"
    summary = carry_out(study(tmp_path, replicates=1), lab, backend=Failing())
    (why,) = summary.tally.failed
    assert why.startswith("packing, seed 1: grain 45 at step 6 (0.06 ms, dt = 10 us) moves at 143 m/s (while filling; ")
    assert "Failed(" not in why
    (folder,) = (path for path in (lab / "work").iterdir() if path.is_dir())
    assert f"the last good state is in {folder})" in why
    told = labbook("status", "--lab", lab).stdout.replace("\n", " ")
    assert "a filling that failed: grain 45 at step 6 (0.06 ms, dt = 10 us) moves at 143 m/s" in told
    assert "resumable" not in told
    plan = labbook("plan", study_file(tmp_path, replicates=1), "--lab", lab, *BACKEND).stdout
    assert "its packing failed: grain 45 at step 6" in " ".join(plan.split())


def test_runs_of_older_versions_that_came_to_the_end_of_their_time_can_be_read(tmp_path):
    asked = study(tmp_path, "stop: {max_time: 20 ms}", replicates=1)
    carry_out(asked, tmp_path / "lab")
    for run in (tmp_path / "lab/runs").iterdir():
        text = unsealed((run / RunRecord.FILE).read_text())
        assert "interrupted" not in text
        (run / RunRecord.FILE).write_text(text.replace('"time-limit"', '"interrupted"'))
    assert {record.outcome for record in records(tmp_path / "lab").values()} == {"time-limit"}
    labbook("reindex", "--lab", tmp_path / "lab")
    assert not carry_out(asked, tmp_path / "lab").tally.ran
    plan = labbook("plan", study_file(tmp_path, replicates=1), "--lab", tmp_path / "lab", *BACKEND).stdout
    assert "out of time after 0.02 s" in " ".join(plan.split())


@pytest.mark.parametrize(("backend", "module"), [("warp", "warp"), ("numba", "numba")])
def test_an_backend_without_its_package_is_one_line_with_the_remedy(tmp_path, monkeypatch, backend, module):
    monkeypatch.setitem(sys.modules, module, None)
    remedy = f"pip install 'labbook[{backend}]'"
    with pytest.raises(BackendMissing, match=f"needs the package {module}, which is not installed"):
        load(backend)
    path, lab = study_file(tmp_path), tmp_path / "lab"
    for words in (
        ("run", path, "--lab", lab, "--backend", backend),
        ("verify", "--backend", backend),
        ("bench", "--backend", backend),
        ("compare", path, "--lab", lab, "--backends", f"toy,{backend}"),
    ):
        ended = labbook(*words, check=False)
        assert ended.exit_code, words
        said = " ".join(ended.stderr.replace("│", "").split())
        assert remedy in said.replace("' labbook", "'labbook"), (words, ended.stderr)
        assert "Traceback" not in ended.output
    shown = labbook("doctor", check=False, COLUMNS="300").stdout
    assert remedy in shown
    planned = " ".join(labbook("plan", path, "--lab", lab, "--backend", backend).output.split())
    assert f"{remedy}; until then labbook run refuses" in planned


def test_long_labels_cut_no_other_column_of_the_runs(tmp_path):
    path, lab = study_file(tmp_path, replicates=1), tmp_path / "lab"
    names = ", ".join(f"{{container.orifice: {mm} mm, contact.friction: 0.{mm}, grains.density: 25{mm} kg/m^3, "
                      f"contact.restitution: 0.{mm}, contact.rolling_friction: 0.0{mm}, gravity: 9.{mm} m/s^2}}"
                      for mm in (21, 24))  # fmt: skip
    text = path.read_text()
    assert "sweep:" in text
    path.write_text(re.sub(r"sweep: *\n .*\n|sweep:.*\n", f"points: [{names}]\n", text))
    labbook("run", path, "--lab", lab, *BACKEND)
    told = labbook("runs", "--lab", lab).stdout
    assert "t [s]" in told
    for key in (run.name for run in (lab / "runs").iterdir()):
        assert re.search(rf"{key[:10]} +toy-study .* 1 +toy \d+ +finished ", told)
