"""The picture that every run leaves: of which moment it is, and that no run depends on it."""

import errno
import json
import logging
import os
import shutil

import labbook_numba
import numpy as np
import pytest
from labbook_toy import Backend
from PIL import Image
from toy_lab import arrays, carry_out, study, study_file
from toy_lab import labbook as verb
from toy_records import outcomes

from labbook import Lab, load
from labbook.lab import Catalogue
from labbook.lab.folder import DiskFull, stamp
from labbook.lab.runs import PICTURE, open_run, picture
from labbook.picture import SIZE, bed

ONE = {"orifices": "[24]", "replicates": 1}


@pytest.fixture
def seen(monkeypatch) -> list[int]:
    """How many grains were there in each picture that was drawn."""
    found: list[int] = []

    def drawn(scene, start, now):
        found.append(len(now))
        return bed(scene, start, now)

    monkeypatch.setattr("labbook.run.discharge.bed", drawn)
    return found


def fails(problem: BaseException):
    def drawn(*_):
        raise problem

    return drawn


def the_run(lab):
    (folder,) = (lab / "runs").iterdir()
    return folder


def test_every_run_has_a_picture_of_the_middle_of_its_window(tmp_path, seen):
    carry_out(study(tmp_path), tmp_path / "lab")
    for folder in (tmp_path / "lab/runs").iterdir():
        path = picture(folder)
        assert path == folder / PICTURE
        assert path is not None
        with Image.open(path) as image:
            assert max(image.size) == SIZE
    left = [1 - grains / 200 for grains in seen]
    assert len(left) == 4
    assert all(0.375 <= part < 0.42 for part in left), "the window is from 15 to 60 %; a beat lets few grains go"


def test_the_middle_is_that_of_the_study_s_window(tmp_path, seen):
    carry_out(study(tmp_path, "window: {start: 0.1, end: 0.3}", **ONE), tmp_path / "lab")
    assert 150 < seen[0] <= 160


def test_a_run_that_ends_before_has_a_picture_of_its_end(tmp_path, seen):
    asked = study(tmp_path, "stop: {stall: 0.5 s}", orifices="[8]", replicates=1)
    assert outcomes(carry_out(asked, tmp_path / "lab")) == ["clogged"]
    assert seen == [200 - 200 // 3]
    assert picture(the_run(tmp_path / "lab")) is not None


def test_a_run_that_a_guard_ends_has_a_picture(tmp_path):
    backend = Backend(fails=24)
    assert outcomes(carry_out(study(tmp_path, **ONE), tmp_path / "lab", backend=backend)) == ["diverged"]
    assert picture(the_run(tmp_path / "lab")) is not None


def test_a_bed_without_outlet_has_a_picture_of_its_end(tmp_path, seen):
    path = study_file(tmp_path, "stop: {max_time: 20 ms}", replicates=1)
    text = path.read_text()
    start, end = text.index("container:"), text.index("replicates:")
    box = "container: {kind: box, width: 60 mm, depth: 3.03 mm, height: 300 mm}\n"
    text = text[:start] + box + text[end:]
    path.write_text(text.replace("measure: [flow_rate]", "measure: [packing]"))
    assert outcomes(carry_out(load(path), tmp_path / "lab")) == ["time-limit"]
    assert seen == [200]
    assert picture(the_run(tmp_path / "lab")) is not None


def test_a_run_that_goes_on_gets_a_new_picture(tmp_path, seen):
    carry_out(study(tmp_path, "stop: {max_time: 20 ms}", **ONE), tmp_path / "lab")
    before = (the_run(tmp_path / "lab") / PICTURE).read_bytes()
    carry_out(study(tmp_path, **ONE), tmp_path / "lab")
    assert (the_run(tmp_path / "lab") / PICTURE).read_bytes() != before
    assert 0.375 <= 1 - seen[1] / 200 < 0.42


def test_a_run_that_goes_on_after_the_middle_is_drawn_at_once(tmp_path, seen):
    class Killed(Backend):
        def open(self, spec, slots=None, device="cpu"):
            ensemble = super().open(spec, slots, device)
            advance = ensemble.advance

            def until_half(beats=1):
                if any(len(ensemble.packing(member)) < 100 for member in ensemble.glasses):
                    raise KeyboardInterrupt
                return advance(beats)

            ensemble.advance = until_half
            return ensemble

    asked = study(tmp_path, **ONE)
    with pytest.raises(KeyboardInterrupt):
        carry_out(asked, tmp_path / "lab", backend=Killed(), checkpoint_every=0)
    assert carry_out(asked, tmp_path / "lab").tally.resumed == 1
    (drawn,) = seen
    assert 90 <= drawn <= 100, "as it was where it went on"
    assert picture(the_run(tmp_path / "lab")) is not None


def test_a_run_is_the_same_whether_it_is_drawn_or_not(tmp_path, monkeypatch):
    asked = study(tmp_path, "record: {every: 2 ms, replicates: 1}")
    carry_out(asked, tmp_path / "drawn")
    monkeypatch.setattr("labbook.run.discharge.RunOutput._picture", lambda *_: b"")
    carry_out(asked, tmp_path / "plain")
    for folder in (tmp_path / "plain/runs").iterdir():
        assert not (folder / PICTURE).exists()
        drawn = tmp_path / "drawn/runs" / folder.name
        assert (drawn / PICTURE).exists()
        assert arrays(drawn) == arrays(folder)
    own = [Catalogue(tmp_path / name).measurements().to_csv() for name in ("drawn", "plain")]
    assert own[0] == own[1]


@pytest.mark.parametrize("problem", [ValueError("no such colour"), MemoryError(), OSError(errno.EIO, "broken")])
def test_a_run_that_cannot_be_drawn_is_done_without_a_picture(tmp_path, monkeypatch, caplog, problem):
    monkeypatch.setattr("labbook.run.discharge.bed", fails(problem))
    with caplog.at_level(logging.WARNING, "labbook"):
        assert outcomes(carry_out(study(tmp_path, **ONE), tmp_path / "lab")) == ["finished"]
    (record,) = caplog.records
    assert "the bed was not drawn" in record.getMessage()
    assert type(problem).__name__ in record.getMessage()
    folder = the_run(tmp_path / "lab")
    open_run(folder)
    assert picture(folder) is None
    assert not list((tmp_path / "lab/work").iterdir())


def test_a_state_that_cannot_be_taken_costs_the_picture_and_nothing_else(tmp_path, caplog):
    class Odd(Backend):
        def open(self, spec, slots=None, device="cpu"):
            ensemble = super().open(spec, slots, device)
            if not spec.feature("closed"):
                took = ensemble.packing
                first = iter([True])  # which is drawn; a run that leaves none at its end is not kept

                def packing(member):
                    if next(first, False):
                        raise RuntimeError("no packings today")
                    return took(member)

                ensemble.packing = packing  # pyright: ignore[reportAttributeAccessIssue]
            return ensemble

    assert outcomes(carry_out(study(tmp_path, **ONE), tmp_path / "lab", backend=Odd())) == ["finished"]
    assert "no packings today" in caplog.text
    assert picture(the_run(tmp_path / "lab")) is None


def test_who_stops_a_run_while_it_is_drawn_stops_it(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("labbook.run.discharge.bed", fails(KeyboardInterrupt()))
        with pytest.raises(KeyboardInterrupt):
            carry_out(study(tmp_path, **ONE), tmp_path / "lab")
    assert not list((tmp_path / "lab").glob("runs/*"))
    assert outcomes(carry_out(study(tmp_path, **ONE), tmp_path / "lab")) == ["finished"]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no device that is always full")
def test_a_disk_that_is_full_when_the_picture_is_written_is_told(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("labbook.run.discharge.PICTURE", "/dev/full")
        with pytest.raises(DiskFull):
            carry_out(study(tmp_path, **ONE), tmp_path / "lab")
    assert outcomes(carry_out(study(tmp_path, **ONE), tmp_path / "lab")) == ["finished"]
    assert picture(the_run(tmp_path / "lab")) is not None


def nothing(path):
    path.unlink()


def empty(path):
    path.write_bytes(b"")


def truncated(path):
    path.write_bytes(path.read_bytes()[:-40])


def garbage(path):
    path.write_bytes(np.random.default_rng(1).bytes(3000))


def huge(path):
    """A picture that says it has 2^31 pixels a side: whoever unpacks it needs more memory than there is."""
    content = path.read_bytes()
    path.write_bytes(content[:16] + b"\x7f\xff\xff\xff" * 2 + content[24:])


def long(path):
    content = path.read_bytes()
    path.write_bytes(content[:-12] + bytes(2**20) + content[-12:])


def folder(path):
    path.unlink()
    path.mkdir()


def pipe(path):
    path.unlink()
    os.mkfifo(path)


def dangling(path):
    path.unlink()
    path.symlink_to("nowhere")


DAMAGES = [nothing, empty, truncated, garbage, huge, long, folder, pipe, dangling]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A lab with one run."""
    folder = tmp_path_factory.mktemp("sound")
    carry_out(study(folder, **ONE), folder / "lab")
    return folder


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_run_without_a_whole_picture_is_as_good(sound, tmp_path, damage):
    shutil.copytree(sound / "lab", tmp_path / "lab")
    lab, asked = tmp_path / "lab", study_file(tmp_path, **ONE)
    run = the_run(lab)
    labbook("fit", asked, lab)
    seen, kept = stamp(run), {path.name: path.stat().st_mtime_ns for path in run.glob("measured-*")}
    damage(run / PICTURE)
    assert picture(run) is None
    assert stamp(run) == seen, "it is not read again for that"
    open_run(run)
    shown = json.loads(labbook("show", run.name, lab, "--json").output)
    assert shown["picture"] is None
    ended = labbook("run", asked, lab)
    assert "1 of 1 runs done" in ended.output.splitlines()
    labbook("fit", asked, lab)
    labbook("reindex", None, lab)
    assert "1 of 1 runs done" in labbook("run", asked, lab).output.splitlines()
    assert {path.name: path.stat().st_mtime_ns for path in run.glob("measured-*")} == kept, "nor evaluated again"


def labbook(name, what, lab, *more):
    """A verb for a study, a run or a lab."""
    own = ("--backend", "toy") if name in ("fit", "run") else ()
    return verb(name, *([what] if what else []), "--lab", lab, *own, *more)


def test_show_and_python_say_where_the_picture_is(sound, tmp_path):
    run = the_run(sound / "lab")
    path = run / PICTURE
    assert json.loads(labbook("show", run.name, sound / "lab", "--json").output)["picture"] == str(path)
    assert str(path) in labbook("show", run.name, sound / "lab").output.replace("\n", "")
    results = Lab(sound / "lab", backend="toy").results(study(tmp_path, **ONE), progress=False)
    assert results.run(1).picture == path


@pytest.mark.parametrize("damage", [None, garbage, huge, empty])
def test_import_brings_whole_pictures_only(sound, tmp_path, damage):
    shutil.copytree(sound / "lab", tmp_path / "theirs")
    if damage:
        damage(the_run(tmp_path / "theirs") / PICTURE)
    labbook("import", tmp_path / "theirs", tmp_path / "ours")
    run = the_run(tmp_path / "ours")
    open_run(run)
    assert (run / PICTURE).exists() == (damage is None)


@pytest.mark.compiles
def test_a_real_run_is_the_same_whether_it_is_drawn_or_not(tmp_path, monkeypatch):
    asked = study(tmp_path, count=150, **ONE)
    backend = labbook_numba.Backend(wide=True)
    carry_out(asked, tmp_path / "drawn", backend=backend)
    monkeypatch.setattr("labbook.run.discharge.RunOutput._picture", lambda *_: b"")
    carry_out(asked, tmp_path / "plain", backend=backend)
    drawn, plain = the_run(tmp_path / "drawn"), the_run(tmp_path / "plain")
    assert arrays(drawn) == arrays(plain)
    with Image.open(drawn / PICTURE) as image:
        alpha = np.asarray(image.convert("RGBA"))[..., 3]
    assert 0.1 < (alpha == 255).mean() < 0.9
