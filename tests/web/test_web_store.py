"""What the app keeps in memory, and many readers at once beside a study that runs."""

import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import pytest
from labbook_web.store import Cache, LabStore, NotFound
from toy_lab import arrays, labbook, start, study_file
from toy_web import ORIFICES, REPLICATES, client, everything, make, pages, twins

from labbook.accuracy.calibration import PATH
from labbook.lab import Catalogue, LabFolder, studies
from labbook.results.find import find
from labbook.study import StudyError, load

STUDY = "toy-study"


# values by key


def test_a_value_is_made_once_by_many_threads():
    kept, made, gate = Cache(10), Counter(), threading.Barrier(16)

    def make_it():
        made["all"] += 1
        time.sleep(0.05)
        return object()

    def ask(_):
        gate.wait()
        return kept.get("key", 1, make_it)

    with ThreadPoolExecutor(16) as threads:
        values = set(threads.map(ask, range(16)))
    assert made["all"] == len(values) == 1


def test_values_of_other_keys_are_made_side_by_side():
    kept, both = Cache(10), threading.Barrier(2, timeout=10)
    with ThreadPoolExecutor(2) as threads:
        found = list(threads.map(lambda key: kept.get(key, 1, both.wait), ("a", "b")))
    assert sorted(found) == [0, 1], "each waited for the other one"


def test_another_state_is_another_value():
    kept = Cache(10)
    assert kept.get("key", 1, lambda: "first") == "first"
    assert kept.get("key", 1, lambda: "second") == "first"
    assert kept.get("key", 2, lambda: "second") == "second"
    assert kept.get("key", 1, lambda: "third") == "third", "only the latest state is kept"


def test_a_value_that_took_long_may_be_old_for_a_while(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    kept = Cache(10)

    def slow():
        clock[0] += 2.0
        return "first"

    assert kept.get("key", 1, slow, age_factor=5) == "first"
    clock[0] += 9.9
    assert kept.get("key", 2, lambda: "second", age_factor=5) == "first"
    clock[0] += 0.2
    assert kept.get("key", 2, lambda: "second", age_factor=5) == "second"


def test_the_ones_made_longest_ago_are_forgotten():
    kept, made = Cache(3), []

    def get(key):
        return kept.get(key, 1, lambda: made.append(key) or key)

    for key in "abc":
        get(key)
    get("d")
    for key in "dcb":
        get(key)
    assert made == list("abcd")
    get("a")
    assert made == list("abcda")
    assert len(kept.values) == 3


def test_whoever_fails_leaves_the_place_to_the_next():
    kept = Cache(3)
    with pytest.raises(ZeroDivisionError):
        kept.get("key", 1, lambda: 1 / 0)
    assert kept.get("key", 1, lambda: 7) == 7


# states


def test_a_state_is_of_what_is_shown(done, tmp_path):
    first, other = (LabStore(done / "lab").contents(STUDY, "toy") for _ in range(2))
    assert first.state == other.state
    assert LabStore(done / "lab").contents(STUDY, "twin").state != first.state
    changed = tmp_path / "toy.yaml"
    changed.write_text((done / "toy.yaml").read_text() + "# a remark\n")
    assert LabStore(done / "lab", [changed]).contents(STUDY, "toy").state != first.state


def test_results_are_found_once_while_nothing_changes(copied, monkeypatch):
    count = Counter()

    def counted(*given):
        count["found"] += 1
        return results(*given)

    from labbook_web import store as module

    results = module.stored_results
    monkeypatch.setattr(module, "stored_results", counted)
    monkeypatch.setattr(module, "AGE_FACTOR", 0)
    store = LabStore(copied / "lab")
    for _ in range(3):
        assert len(store.contents(STUDY, "toy").results.points) == len(ORIFICES)
    assert count["found"] == 1
    study_file(copied, "fit: [beverloo]", count=400, orifices="[36]", replicates=1)
    labbook("run", copied / "toy.yaml", "--lab", copied / "lab", "--backend", "toy")
    assert len(store.contents(STUDY, "toy").results.points) == 1, "the text of the study changed"
    assert count["found"] == 2


def test_results_are_old_only_while_a_study_runs(copied, monkeypatch):
    """A page follows a study until nobody runs it; what it is told then is all that there is."""
    going = [object()]
    monkeypatch.setattr(LabStore, "running", lambda self: going)
    monkeypatch.setattr("labbook_web.store.AGE_FACTOR", 1e9)
    store = LabStore(copied / "lab")
    assert len(store.contents(STUDY, "toy").results.points[0].runs) == REPLICATES
    path = copied / "lab/study-files/toy-study.yaml"
    stamp = path.stat()
    labbook("run", copied / "toy.yaml", "--lab", copied / "lab", "--backend", "toy", LABBOOK_TOY_VERSION="2")
    assert path.stat().st_mtime_ns == stamp.st_mtime_ns
    assert store.contents(STUDY, "toy").results.stale == {}
    going.clear()
    assert store.contents(STUDY, "toy").state
    assert {run.cache_version for one in store.contents(STUDY, "toy").results.points for run in one.runs} == {2}


def test_the_index_is_opened_again_when_it_was_replaced(copied):
    store = LabStore(copied / "lab")
    before = store.catalogue
    assert store.catalogue is before
    (copied / "lab/catalogue.db").unlink()
    labbook("reindex", "--lab", copied / "lab")
    assert store.catalogue is not before
    assert len(store.catalogue.runs()) == len(ORIFICES) * REPLICATES


def test_given_files_count_before_those_of_the_lab(done, tmp_path):
    own = study_file(tmp_path, orifices="[18]", count=400)
    assert len(LabStore(done / "lab").study(STUDY)[0].points) == len(ORIFICES)
    assert len(LabStore(done / "lab", [own]).study(STUDY)[0].points) == 1
    other = tmp_path / "other.yaml"
    other.write_text(own.read_text().replace(STUDY, "other"))
    assert [one.name for one in LabStore(done / "lab", [other], extra_only=True).listings()] == ["other"]
    assert {one.name for one in LabStore(done / "lab", [other]).listings()} == {STUDY, "other"}
    with pytest.raises(NotFound, match="other"):
        LabStore(done / "lab", [other], extra_only=True).study(STUDY)
    own.write_text("name: [")
    assert [one.problem != "" for one in LabStore(done / "lab", [own]).listings()].count(True) == 1


def test_a_kept_study_has_the_calibration_that_is_kept_with_it(tmp_path):
    own = study_file(tmp_path, "accuracy: {flow_rate: 40 %, calibration: ../elsewhere.json}")
    lab = LabFolder(tmp_path / "lab")
    studies.keep(lab, STUDY, own.read_text(), PATH)
    assert LabStore(lab.folder).study(STUDY)[0].calibration_file == lab.studies / f"{STUDY}.calibration.json"


def test_a_study_that_changes_is_read_again(done, tmp_path):
    own = study_file(tmp_path, orifices="[18]")
    store = LabStore(done / "lab", [own])
    assert len(store.study(STUDY)[0].points) == 1
    study_file(tmp_path, orifices="[18, 21, 24]")
    assert len(store.study(STUDY)[0].points) == 3
    own.unlink()
    assert len(store.study(STUDY)[0].points) == len(ORIFICES), "the lab still has one of that name"
    with pytest.raises(StudyError):
        LabStore(done / "lab", extra_only=True).study_cache.get("x", 1, lambda: load(tmp_path / "none.yaml"))


# many at once


def test_many_threads_read_an_empty_lab(tmp_path):
    somebody = client(tmp_path / "none")

    def ask(address):
        return somebody.get(address).status_code

    with ThreadPoolExecutor(8) as threads:
        assert set(threads.map(ask, ["/", "/runs", "/index.json", "/runs.csv", "/compare"] * 8)) == {200}


@pytest.mark.ring
@pytest.mark.slow
def test_readers_neither_hold_up_nor_break_a_study_that_runs(tmp_path):
    """Eight threads ask for all pages over and over while a process adds runs; in the end it has lost nothing."""
    orifices, replicates = "[18, 24, 30]", 4
    make(tmp_path, orifices="[18]", replicates=1)
    lab = tmp_path / "lab"
    path = study_file(tmp_path, "fit: [beverloo]", count=400, orifices=orifices, replicates=replicates)
    somebody = client(lab)
    running = start("run", path, "--lab", lab, "--backend", "toy", delay=0.02)
    seen, wrong, totals = Counter(), [], []

    def ask(address):
        asked = time.perf_counter()
        answer = somebody.get(address)
        answered = time.perf_counter()
        seen[answer.status_code] += 1
        not_yet = answer.status_code == 404 and (
            "point" in address or "explore" in address
        )  # of the first outlet alone
        if answer.status_code >= 400 and not not_yet:
            wrong.append((address, answer.status_code, answer.text[-300:]))
        if address == "/runs.json" and answer.status_code == 200:
            totals.append((asked, answered, answer.json()["total"]))

    with ThreadPoolExecutor(8) as threads:
        while running.poll() is None:
            shown = pages(lab, STUDY, 3)
            list(
                threads.map(ask, [*shown, *(twins(page, "json") for page in shown), "/runs.json", f"/progress/{STUDY}"])
            )
    out, err = running.communicate()
    assert running.returncode == 0, out + err
    assert "locked" not in out + err
    assert wrong == []
    assert seen[200] > 100
    # two pages ask for the runs at once, and either may be answered first: only what was answered before counts
    before = [max((n for _, answered, n in totals if answered <= asked), default=0) for asked, _, _ in totals]
    assert all(known <= n for known, (_, _, n) in zip(before, totals, strict=True)), "runs only come"
    assert len({n for _, _, n in totals}) > 1, "they came while somebody looked"
    frame = Catalogue(lab).runs()
    assert len(frame) == 3 * replicates
    assert set(frame["outcome"]) == {"finished"}
    assert all(arrays(folder) for folder in (lab / "runs").iterdir())
    assert not list(LabFolder(lab).folder.glob("work/*"))
    found = find(load(path), Catalogue(lab), "toy")
    assert [len(one.runs) for one in found.points] == [replicates] * 3
    assert found.unreadable == ()
    assert {client(lab).get(address).status_code for address in everything(lab, STUDY, 3)} == {200}


def test_pages_name_the_discharge_of_a_bed(tmp_path):
    make(tmp_path, "discharges_per_bed: 2", orifices="[24]", replicates=2)
    lab = tmp_path / "lab"
    asker = client(lab)
    catalogue = Catalogue(lab)
    rows = catalogue.runs()
    catalogue.close()
    key = rows.loc[(rows["seed"] == 2) & (rows["discharge"] == 2), "run_key"].item()
    for page in (f"/run/{key[:16]}", f"/study/{STUDY}/point/1", "/runs", f"/compare?item=run:{key[:16]}"):
        answer = asker.get(page)
        assert answer.status_code == 200
        assert "2, discharge 2" in answer.text
    assert {asker.get(page).status_code for page in everything(lab, STUDY, 1)} == {200}
