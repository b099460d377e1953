"""The catalogue is an index: it can be made again, merged, and survives folders that cannot be read."""

import json
import shutil
import unicodedata

import pytest
from labbook_toy import Backend
from sqlalchemy import event, text
from toy_lab import APP, carry_out, study, study_file, unsealed
from typer.testing import CliRunner

import labbook
from labbook.lab import Catalogue, LabFolder, NoCatalogue, RunRecord, Unreadable
from labbook.lab.catalogue import Listing
from labbook.lab.database import SCHEMA_VERSION, metadata, open_engine, runs
from labbook.lab.index import Index
from labbook.lab.merge import Merged, merge
from labbook.measure import MEASURES
from labbook.plan import coverage

EVERYTHING = ("runs", "packings", "measurements")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A lab with four finished runs, for copies."""
    folder = tmp_path_factory.mktemp("finished")
    carry_out(study(folder), folder / "lab")
    return folder / "lab"


@pytest.fixture
def lab(finished, tmp_path):
    """A lab with four finished runs."""
    return shutil.copytree(finished, tmp_path / "lab")


def tables(lab) -> dict[str, list]:
    with open_engine(LabFolder(lab), read_only=True).connect() as connection:
        return {name: sorted(map(repr, connection.execute(metadata.tables[name].select()))) for name in EVERYTHING}


def cli(*words) -> tuple[int, str]:
    done = CliRunner().invoke(APP, [str(word) for word in words])
    return done.exit_code, done.output


def test_made_again_it_is_the_same(lab):
    before = tables(lab)
    assert [len(before[name]) for name in EVERYTHING] == [4, 2, 12]
    for suffix in ("", "-wal", "-shm"):
        (lab / f"catalogue.db{suffix}").unlink(missing_ok=True)
    with pytest.raises(NoCatalogue, match="labbook reindex"):
        Catalogue(lab)
    code, out = cli("reindex", "--lab", lab)
    assert (code, out.strip()) == (0, "4 runs and 2 packings indexed")
    assert tables(lab) == before


def test_one_of_another_version_is_made_again_by_whoever_writes(lab):
    before = tables(lab)
    with open_engine(LabFolder(lab), read_only=False).connect() as connection:
        connection.execute(text(f"UPDATE about SET schema_version = {SCHEMA_VERSION + 1}"))
        connection.execute(text("ALTER TABLE runs ADD COLUMN later TEXT"))
        connection.commit()
    with pytest.raises(NoCatalogue, match="another version"):
        Catalogue(lab)
    Index(LabFolder(lab)).close()
    assert tables(lab) == before


def test_a_damaged_one_is_made_again(lab):
    before = tables(lab)
    for suffix in ("-wal", "-shm"):
        (lab / f"catalogue.db{suffix}").unlink(missing_ok=True)
    (lab / "catalogue.db").write_bytes(b"this is no database " * 300)
    with pytest.raises(NoCatalogue, match="damaged"):
        Catalogue(lab)
    assert cli("reindex", "--lab", lab)[0] == 0
    assert tables(lab) == before


def test_a_lab_without_anything_is_empty_not_wrong(tmp_path):
    assert Catalogue(tmp_path / "none").counts() == {}
    assert not (tmp_path / "none").exists(), "looking makes nothing"


@pytest.mark.parametrize("there", [False, True])
@pytest.mark.parametrize("verb", ["status", "runs", "show", "reindex", "fit", "report", "export", "view", "compare"])
def test_a_lab_that_is_not_there_is_named(tmp_path, verb, there):
    lab, asked = tmp_path / "typo", study_file(tmp_path)
    if there:
        lab.mkdir()
    words = {"show": ["abc"], "compare": [asked, "--show"]}.get(
        verb, [] if verb in ("status", "runs", "reindex") else [asked]
    )
    code, out = cli(verb, *words, "--lab", lab)
    assert code == 1
    assert str(lab) in out
    assert "lab" in out
    assert lab.exists() == there, "looking makes nothing"
    assert not there or not list(lab.iterdir())


def test_an_outcome_that_no_run_has_is_named_with_those_that_there_are(lab):
    code, out = cli("runs", "--lab", lab, "--outcome", "bogus")
    assert code == 1
    assert "bogus" in out
    assert "finished, precise, emptied, clogged, diverged, time-limit, unreadable, suspect" in out
    assert cli("runs", "--lab", lab, "--outcome", "clogged")[0] == 0


def test_a_study_that_no_run_was_made_for_is_named_with_those_that_there_are(lab):
    code, out = cli("runs", "--lab", lab, "--study", "toy-stduy")
    assert code == 1
    assert "toy-stduy" in out
    assert "use one of: toy-study" in out
    assert cli("runs", "--lab", lab, "--study", "toy-study")[0] == 0


def test_the_version_is_told():
    assert cli("--version") == (0, f"labbook {labbook.__version__}\n")


def test_what_files_say_does_not_steer_the_terminal(lab, tmp_path):
    victim = sorted((lab / "runs").iterdir())[0]
    record = json.loads(unsealed((victim / "run.json").read_text()))
    record |= {"label": "here \x1b[31m\x07\u202e", "finished": "\x9b1m"}
    (victim / "run.json").write_text(json.dumps(record))
    (lab / "work" / "\x1b[2J").mkdir(parents=True)
    (lab / "runs" / "\x1b[8m").mkdir()
    cited = study_file(tmp_path, 'reference: {source: "a \\u001b[31m paper", flow_rate: [{value: 3 g/s}]}')
    for words in (
        ("reindex",), ("status",), ("runs",), ("show", victim.name), ("fit", cited, "--backend", "toy"),
        ("plan", cited, "--backend", "toy"), ("show", "\x1b[8m"),
    ):  # fmt: skip
        out = CliRunner().invoke(APP, [*map(str, words), "--lab", str(lab)], color=True).output
        assert out
        assert not [one for one in out if unicodedata.category(one) == "Cc" and one != "\n"], words
        assert "\u202e" not in out
    assert "here \N{REPLACEMENT CHARACTER}[31m" in cli("runs", "--lab", lab)[1]


@pytest.mark.parametrize("harm", ["cut", "empty", "gone", "renamed", "table", "half a table"])
def test_a_folder_that_cannot_be_read_is_one_red_row(lab, harm):
    victim = sorted((lab / "runs").iterdir())[0]
    record = victim / "run.json"
    if harm == "cut":
        record.write_bytes(record.read_bytes()[:100])
    elif harm == "empty":
        record.write_bytes(b"")
    elif harm == "gone":
        record.unlink()
    elif harm == "renamed":
        victim = victim.rename(victim.with_name("0" * 24))
    elif harm == "table":
        (victim / "crossing.npz").write_bytes(b"nothing")
    else:
        table = victim / "crossing.npz"
        table.write_bytes(table.read_bytes()[:300])
    code, out = cli("reindex", "--lab", lab)
    assert code == 0
    assert "Unreadable" in out
    found = Catalogue(lab).runs()
    assert sorted(found.outcome) == ["finished"] * 3 + ["unreadable"]
    red = found.set_index("outcome").loc["unreadable"]
    assert red.run_key == victim.name
    assert str(victim) in red.problem
    code, out = cli("runs", "--lab", lab)
    assert code == 0
    assert "unreadable" in out
    assert json.loads(cli("status", "--lab", lab, "--json")[1])["runs"] == {"finished": 3, "unreadable": 1}


def test_an_unreadable_run_is_run_again(lab, tmp_path):
    victim = sorted((lab / "runs").iterdir())[0]
    (victim / "run.json").write_bytes(b"{}")
    with pytest.raises(Unreadable, match=r"run\.json"):
        RunRecord.read(victim)
    cli("reindex", "--lab", lab)
    asked = study_file(tmp_path)
    code, out = cli("plan", asked, "--lab", lab, "--backend", "toy", "--json")
    plan = json.loads(out)
    assert code == 0
    assert plan["counts"] == {"done": 3, "missing": 1}
    assert "cannot be read" in next(run["reason"] for run in plan["runs"] if run["state"] == "missing")
    summary = carry_out(study(tmp_path), lab)
    assert list(summary.tally.ran) == [victim.name]
    assert Catalogue(lab).counts() == {"finished": 4}


def test_a_run_that_was_not_indexed_is_found(lab):
    key = sorted((lab / "runs").iterdir())[0].name
    with open_engine(LabFolder(lab), read_only=False).connect() as connection:
        connection.execute(runs.delete().where(runs.c.run_key == key))
        connection.commit()
    assert len(Catalogue(lab).runs()) == 3
    found = Index(LabFolder(lab)).report
    assert (found.runs, found.vanished) == (1, 0)
    shutil.rmtree(lab / "runs" / key)
    found = Index(LabFolder(lab)).report
    assert (found.runs, found.vanished) == (0, 1)
    assert key not in set(Catalogue(lab).measurements().run_key)


def test_labs_merge(lab, tmp_path):
    other = tmp_path / "other"
    carry_out(study(tmp_path, orifices="[24, 30]"), other)
    code, out = cli("import", other, "--lab", lab)
    first, second = out.splitlines()
    assert (code, first) == (0, "Runs and packings imported: 2"), "one point is new, with both seeds"
    assert second.startswith("Not replaced: the study file toy-study of this lab differs and is kept")
    carry_out(study(tmp_path, orifices="[18, 24, 30]"), tmp_path / "both")
    names = [list(Catalogue(folder).runs().run_key.sort_values()) for folder in (lab, tmp_path / "both")]
    assert names[0] == names[1]
    assert not carry_out(study(tmp_path, orifices="[18, 24, 30]"), lab).tally.ran
    assert cli("import", other, "--lab", lab)[1].startswith("Runs and packings imported: 0\n")
    assert cli("import", tmp_path / "nothing", "--lab", lab)[0] == 1


def test_of_two_the_one_that_covers_more_is_imported(tmp_path):
    short, long = tmp_path / "short", tmp_path / "long"
    carry_out(study(tmp_path, "stop: {max_time: 20 ms}", replicates=1), short)
    carry_out(study(tmp_path, replicates=1), long)
    merged = merge(Index(LabFolder(long)), short)
    (stayed,) = merged.stayed
    assert "the study file toy-study of this lab differs" in stayed
    assert merged == Merged(stayed=[stayed]), "nothing is copied, and nothing left out"
    merged = merge(Index(LabFolder(short)), long)
    assert (len(merged.copied), merged.left_out) == (2, [])
    assert Catalogue(short).counts() == {"finished": 2}


def flow_rates(lab):
    """All of the index."""
    return Catalogue(lab).measurements().query("quantity == 'flow_rate'")


def test_numbers_are_derived_again_when_a_measure_or_the_window_changes(lab, tmp_path, monkeypatch):
    before = flow_rates(lab)
    assert len(before) == 4
    other = study(tmp_path, "window: {start: 0.3, end: 0.6}")
    summary = carry_out(other, lab)
    assert summary.work_done == 0, "without simulating"
    after = flow_rates(lab)
    assert sorted(after.window_start) == [0.15] * 4 + [0.3] * 4
    latest = dict(zip(after.run_key[after.window_start == 0.3], after.value[after.window_start == 0.3], strict=True))
    assert Catalogue(lab).flow_rates(list(latest)) == latest, "of the window that opens last"
    listed, _ = Catalogue(lab).listed(Listing())
    assert dict(zip(listed.run_key, listed.flow_rate, strict=True)) == latest
    monkeypatch.setattr(type(MEASURES["flow_rate"]), "version", 99)
    summary = carry_out(other, lab)
    assert summary.work_done == 0
    newest = flow_rates(lab)
    assert len(newest[newest.version == 99]) == 4
    assert list(newest[newest.version == 99].value) == list(after[after.window_start == 0.3].value)


def test_two_studies_of_one_name_are_told_apart(lab, tmp_path):
    shown = labbook_said(lab)
    assert "scene" not in shown
    path = study_file(tmp_path)
    path.write_text(path.read_text().replace("friction: 0.5", "friction: 0.4"))
    carry_out(labbook.load(path), lab)
    found = Catalogue(lab).runs()
    assert found.groupby(["label", "seed"]).size().tolist() == [2] * 4
    shown = labbook_said(lab)
    for row in found.to_dict("records"):
        (line,) = [line for line in shown.splitlines() if line.strip().startswith(row["run_key"][:10])]
        assert f"{row['label']} (scene {row['scene_key'][:6]})" in line
    assert "Runs of different studies with one name (toy-study)" in shown


def labbook_said(lab) -> str:
    code, out = cli("runs", "--lab", lab)
    assert code == 0
    return out


def test_a_run_is_shown_by_the_beginning_of_its_key(lab):
    key = sorted((lab / "runs").iterdir())[0].name
    code, out = cli("show", key[:8], "--lab", lab, "--json")
    assert code == 0
    shown = json.loads(out)
    assert shown["run"]["run_key"] == key
    assert {row["quantity"] for row in shown["measurements"]} >= {"flow_rate", "grain_rate"}
    assert cli("show", key[:8], "--lab", lab)[0] == 0
    code, out = cli("show", "zzz", "--lab", lab)
    assert code == 1
    assert "labbook runs" in out


@pytest.mark.slow
def test_a_hundred_thousand_runs_are_listed(tmp_path):
    index = Index(LabFolder(tmp_path / "lab"))
    index.close()
    count = 100_000
    row = {"study": "s", "label": "orifice 18 mm", "backend": "toy", "cache_version": 1, "outcome": "finished"}
    row |= {"grains": 3000, "discharged": 0.6, "duration": 1.5, "wall_time": 90.0, "rate": 9e6, "stamp": 1}
    synthetic = [
        {**row, "run_key": f"{n:024x}", "lineage_key": f"{n:024x}", "seed": n, "finished": f"2026-{n:06d}"}
        for n in range(count)
    ]
    with open_engine(LabFolder(tmp_path / "lab"), read_only=False).connect() as connection:
        connection.execute(text("BEGIN"))
        connection.execute(runs.insert(), synthetic)
        connection.commit()
    catalogue = Catalogue(tmp_path / "lab")
    latest = catalogue.runs(limit=50)
    assert catalogue.counts() == {"finished": count}
    assert catalogue.matching("0000000000000000000186") == [f"{n:024x}" for n in range(0x18600, 0x1860A)]
    assert len(latest) == 50
    assert latest.seed[0] == count - 1
    assert len(catalogue.runs()) == count


def test_versions_of_the_backend_do_not_mix(tmp_path):
    asked = study(tmp_path, replicates=1)
    carry_out(asked, tmp_path / "lab", backend=Backend(version=1))
    old = {run.entry.run_key for run in coverage.finished(Catalogue(tmp_path / "lab"), asked, "toy")}
    carry_out(asked, tmp_path / "lab", backend=Backend(version=2))
    new = {run.entry.run_key for run in coverage.finished(Catalogue(tmp_path / "lab"), asked, "toy")}
    assert len(old) == len(new) == 2
    assert not old & new


def test_replicates_of_an_older_version_are_not_pooled_with_newer_ones(tmp_path):
    lab = tmp_path / "lab"
    carry_out(study(tmp_path, replicates=4), lab, backend=Backend(version=1))
    fewer = study(tmp_path, "accuracy: {flow_rate: 0.01 %, max_replicates: 4}", replicates=2, orifices="[24]")
    capped = study(tmp_path, replicates=2, orifices="[24]")
    carry_out(capped, lab, backend=Backend(version=2))
    newer = set(Catalogue(lab).runs()[lambda runs: runs.cache_version == 2].run_key)
    found = coverage.finished(Catalogue(lab), fewer, "toy")
    assert [run.seed for run in found] == [1, 2], "seeds 3 and 4 were run by version 1 only"
    assert {run.entry.run_key for run in found} == newer
    both = coverage.finished(Catalogue(lab), study(tmp_path, replicates=4), "toy")
    assert [(run.point.index, run.seed) for run in both] == [(0, 1), (0, 2), (0, 3), (0, 4), (1, 1), (1, 2)]
    assert all(run.record.cache_version == (1 if run.point.index == 0 else 2) for run in both)


def test_what_is_measured_is_asked_of_many_runs_at_once(lab):
    folders = list((lab / "runs").iterdir())
    observe = RunRecord.read(folders[0]).observe
    index, asked = Index(LabFolder(lab)), []
    event.listen(index._engine, "before_cursor_execute", lambda *given: asked.append(given[2]))
    assert index.derive([folder.name for folder in folders], observe) == 0
    assert len(asked) == 1
    longer = observe.model_copy(update={"end": observe.end / 2})
    assert index.derive([folder.name for folder in folders], longer) == 4
    assert index.derive([folder.name for folder in folders], longer) == 0
    index.close()
