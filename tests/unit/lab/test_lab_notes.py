"""Notes and tags of studies and runs: what is kept, what is refused, and who shows them."""

import json
import os
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from labbook_toy import Backend
from toy_lab import carry_out, labbook, study

from labbook.lab import Catalogue, LabError, LabFolder, notes
from labbook.lab.folder import stamp
from labbook.lab.notes import Note

KEY, OTHER = "0123456789abcdef", "fedcba9876543210"
SMALL = {"count": 200, "orifices": "[24]", "replicates": 2}


@pytest.fixture
def lab(tmp_path) -> LabFolder:
    return LabFolder(tmp_path / "lab")


def written(lab: LabFolder, content: bytes) -> Path:
    """A file with a note of the run KEY, as a person may have left it."""
    path = notes.note_path(lab, "run", KEY)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


# files


def test_a_note_is_a_file_that_a_person_can_read(lab):
    notes.write(lab, "run", KEY, Note("Clogged *twice*.\n\nSee seed 3.", ("slow", "for-paper")))
    path = lab.folder / "notes/runs" / f"{KEY}.md"
    assert path.read_text() == "tags: for-paper, slow\n\nClogged *twice*.\n\nSee seed 3.\n"
    assert notes.read(lab, "run", KEY) == Note("Clogged *twice*.\n\nSee seed 3.", ("for-paper", "slow"))
    notes.write(lab, "study", "hopper-1", Note("only text"))
    assert (lab.folder / "notes/studies/hopper-1.md").read_text() == "only text\n"
    assert not list(lab.works.iterdir()), "no lock is left"


def test_there_is_an_empty_note_where_there_is_none(lab):
    assert notes.read(lab, "run", KEY) == Note()
    assert notes.read(lab, "study", "a") == Note()
    assert notes.tagged(lab, "run") == {}
    assert not lab.folder.exists(), "looking makes nothing"


def test_an_empty_note_removes_the_file(lab):
    notes.write(lab, "run", KEY, Note("something"))
    notes.write(lab, "run", KEY, Note(" \n\n"))
    assert not list((lab.notes / "runs").iterdir())
    notes.write(lab, "run", KEY, Note())


@pytest.mark.parametrize(("content", "note"), [
    (b"", Note()),
    (b"tags:", Note()),
    (b"tags: b, a,, b\r\ntext\r\n", Note("text", ("a", "b"))),
    (b"\xef\xbb\xbfTags:a", Note("", ("a",))),
    (b"tags: a\n\n\n  indented\n\n", Note("  indented", ("a",))),
    (b"no tags\ntags: a\n", Note("no tags\ntags: a")),
    ("tags: größe, размер, 粒径, कण, e\u0301".encode(), Note("", ("größe", "é", "размер", "कण", "粒径"))),
])  # fmt: skip
def test_what_people_write_by_hand_is_read(lab, content, note):
    written(lab, content)
    assert notes.read(lab, "run", KEY) == note


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.text(st.characters(exclude_categories=["Cs"]) | st.sampled_from("\n\r \t\ufeff"), max_size=40),
    st.lists(st.text(st.characters(categories=["L", "M", "Nd"]) | st.sampled_from("-_."), min_size=1, max_size=6)),
    st.booleans(),
)
def test_what_was_read_is_written_and_read_again_the_same(lab, text, tags, begins_like_tags):
    note = Note(f"tags: {text}" if begins_like_tags else text, tuple(tags[:20]))
    notes.write(lab, "run", KEY, note)
    once = notes.read(lab, "run", KEY)
    assert set(once.tags) == set(notes.checked(note.tags))
    assert once.text.split() == note.text.replace("\ufeff", "").split() or "\ufeff" in note.text
    notes.write(lab, "run", KEY, once)
    assert notes.read(lab, "run", KEY) == once


@pytest.mark.parametrize(("tags", "said"), [
    (("two words",), "the tag 'two words' has the character ' '"),
    (("a,b",), "has the character ','"),
    (("a/b",), "letters, digits, - _ and . only"),
    (("a\n",), "has the character '\\n'"),
    (("",), "a tag is empty"),
    (("x" * 31,), "31 characters; 30 are allowed"),
    (tuple(f"t{n}" for n in range(21)), "21 tags; 20 are allowed"),
])  # fmt: skip
def test_a_tag_that_cannot_be_kept_is_refused_and_the_old_note_stays(lab, tags, said):
    notes.write(lab, "run", KEY, Note("old", ("x" * 30,)))
    with pytest.raises(ValueError) as problem:
        notes.write(lab, "run", KEY, Note("new", tags))
    assert said in str(problem.value)
    assert notes.read(lab, "run", KEY) == Note("old", ("x" * 30,))


@pytest.mark.parametrize(("text", "said"), [
    ("ä" * 32_000, "64001 bytes with its tags, and 64000 are allowed"),
    ("half \ud800", "character 6 of the note is half of a surrogate pair"),
])  # fmt: skip
def test_a_text_that_cannot_be_kept_is_refused(lab, text, said):
    with pytest.raises(ValueError) as problem:
        notes.write(lab, "run", KEY, Note(text))
    assert said in str(problem.value)
    assert not notes.note_path(lab, "run", KEY).exists()


def test_the_longest_note_that_is_written_can_be_read(lab):
    longest = Note("x" * (notes.MOST_BYTES - len("tags: a\n\n\n")), ("a",))
    notes.write(lab, "run", KEY, longest)
    assert notes.read(lab, "run", KEY) == longest


@pytest.mark.parametrize("kind", ["study", "run"])
@pytest.mark.parametrize("name", ["", "..", "../../etc/passwd", "a/b", "/etc/passwd", "a\0", "a.md", f"{KEY}\n"])
def test_a_name_that_leads_elsewhere_is_refused(lab, kind, name):
    for ask in (lambda: notes.read(lab, kind, name), lambda: notes.write(lab, kind, name, Note("x"))):
        with pytest.raises(ValueError, match="does not name"):
            ask()
    assert not lab.folder.exists()


@pytest.mark.parametrize("key", ["0123456", "0" * 65, "0123456G", "ABCDEF01"])
def test_a_run_is_named_by_its_key(lab, key):
    with pytest.raises(ValueError, match="does not name a run: 8 to 64 digits"):
        notes.read(lab, "run", key)


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


HARMS = {
    "not UTF-8": (lambda path: path.write_bytes(b"\xff\xfe"), "not text in UTF-8"),
    "too large": (lambda path: path.write_bytes(b"x" * 64_001), "more than 64000 bytes"),
    "folder": (folder, "not an ordinary file"),
    "pipe": (pipe, "not an ordinary file"),
    "bad tag": (lambda path: path.write_bytes(b"tags: two words\n"), "has the character ' '"),
}


@pytest.mark.parametrize("harm", HARMS)
def test_a_damaged_note_is_named_and_left_out_of_lists(lab, harm):
    notes.write(lab, "run", OTHER, Note("", ("b", "a")))
    path = written(lab, b"tags: a\n")
    assert notes.tagged(lab, "run") == {KEY: ("a",), OTHER: ("a", "b")}
    assert notes.damaged(lab, "run") == []
    do, said = HARMS[harm]
    do(path)
    with pytest.raises(LabError) as problem:
        notes.read(lab, "run", KEY)
    assert str(path) in str(problem.value)
    assert said in str(problem.value)
    assert notes.tagged(lab, "run") == {OTHER: ("a", "b")}
    assert notes.damaged(lab, "run") == [str(problem.value)]


def test_what_else_lies_there_is_no_note(lab):
    notes.write(lab, "study", "a", Note("", ("x",)))
    for name in ("a.md.part", "b.txt", "1st.md", ".hidden.md"):
        (lab.notes / "studies" / name).write_text("tags: y\n")
    assert notes.tagged(lab, "study") == {"a": ("x",)}


# verbs


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A lab with two runs."""
    folder = tmp_path_factory.mktemp("made")
    carry_out(study(folder, **SMALL), folder / "lab")
    return folder / "lab"


@pytest.fixture
def full(made, tmp_path, monkeypatch) -> tuple[LabFolder, str, str]:
    """A copy of that lab, and the keys of its runs."""
    monkeypatch.setattr("labbook.lab.merge.load", lambda name: Backend())
    shutil.copytree(made, tmp_path / "full")
    lab = LabFolder(tmp_path / "full")
    one, other = sorted(path.name for path in lab.runs.iterdir())
    return lab, one, other


def test_show_tells_note_and_tags(full):
    lab, key, _ = full
    before = labbook("show", key, "--lab", lab.folder).output
    notes.write(lab, "run", key, Note("Clogged [twice].\n\nSee \x1b[31mseed 3.", ("slow", "paper")))
    out = labbook("show", key, "--lab", lab.folder).output
    assert out.startswith(before.rstrip())
    assert out.removeprefix(before.rstrip()).split() == [
        *("tags", "paper,", "slow", "Clogged", "[twice].", "See", "\N{REPLACEMENT CHARACTER}[31mseed", "3.")
    ]
    told = json.loads(labbook("show", key, "--lab", lab.folder, "--json").stdout)
    assert told["note"]["tags"] == ["paper", "slow"]
    assert told["note"]["problem"] is None


def test_show_names_a_damaged_note_and_shows_the_rest(full):
    lab, key, _ = full
    written_to = notes.note_path(lab, "run", key)
    written_to.mkdir(parents=True)
    ended = labbook("show", key, "--lab", lab.folder)
    assert f"Unreadable: {written_to}: " in ended.stderr
    assert "experiment" in ended.stdout
    assert str(written_to) in json.loads(labbook("show", key, "--lab", lab.folder, "--json").stdout)["note"]["problem"]


def test_runs_lists_those_with_a_tag(full):
    lab, key, other = full
    notes.write(lab, "run", key, Note("", ("größe", "slow")))
    notes.write(lab, "run", other, Note("", ("slow",)))

    def listed(*words: object) -> list[str]:
        told = json.loads(labbook("runs", "--lab", lab.folder, "--json", *words).stdout)
        return sorted(row["run_key"] for row in told)

    assert listed("--tag", "slow") == [key, other]
    assert listed("--tag", "gro\u0308ße") == [key]
    assert listed("--tag", "nobody") == []
    assert len(listed("--tag", "slow", "--limit", 1)) == 1
    assert listed("--tag", "slow", "--study", "toy-study") == [key, other]
    assert "1 of 2 runs shown" in labbook("runs", "--lab", lab.folder, "--tag", "größe").output
    ended = labbook("runs", "--lab", lab.folder, "--tag", "two words", check=False)
    assert ended.exit_code == 1
    assert "has the character ' '" in ended.output
    notes.note_path(lab, "run", key).write_bytes(b"\xff")
    assert "not text in UTF-8" in labbook("runs", "--lab", lab.folder, "--tag", "slow").stderr


def test_a_note_may_have_the_short_key_that_runs_are_listed_by(full):
    full, key = full[0].folder, full[1]
    short = full / "notes/runs" / f"{key[:10]}.md"
    short.parent.mkdir(parents=True, exist_ok=True)
    short.write_text("tags: short-one\n\nby hand\n")
    lab = LabFolder(full)
    assert notes.read(lab, "run", key) == Note("by hand", ("short-one",))
    assert notes.tagged(lab, "run")[key] == ("short-one",)
    assert notes.damaged(lab, "run") == []
    assert "by hand" in labbook("show", key[:10], "--lab", full).output
    assert key[:10] in labbook("runs", "--tag", "short-one", "--lab", full).output
    notes.write(lab, "run", key, Note("from the app", ("short-one",)))
    assert short.read_text() == "tags: short-one\n\nfrom the app\n", "there are not two"
    notes.write(lab, "run", key, Note())
    assert not short.exists()


def test_a_note_whose_short_key_is_of_no_run_or_of_two_is_named(full):
    full, key = full[0].folder, full[1]
    (full / "runs" / f"{key[:12]}{'0' * 12}").mkdir()
    folder = full / "notes/runs"
    folder.mkdir(parents=True, exist_ok=True)
    for name in (key[:10], "0" * 10):
        (folder / f"{name}.md").write_text("tags: lost\n")
    output = labbook("runs", "--tag", "lost", "--lab", full).output
    assert f"Unreadable: {folder / key[:10]}.md: the keys of 2 runs begin so; name the file by the whole key" in output
    assert f"Unreadable: {folder / ('0' * 10)}.md: no run has a key that begins so; name the file" in output
    assert "the keys of 2 runs begin so" in labbook("show", key, "--lab", full).output


def test_a_note_changes_no_run(full):
    lab, key, _ = full
    before = stamp(lab.run(key))
    notes.write(lab, "run", key, Note("noted"))
    assert stamp(lab.run(key)) == before
    assert Catalogue(lab).changed([key]) == set()
    labbook("reindex", "--lab", lab.folder)
    assert notes.read(lab, "run", key) == Note("noted")


def test_an_import_brings_notes_along_and_ours_stay(full, tmp_path):
    theirs, key, other = full
    ours = LabFolder(tmp_path / "ours")
    notes.write(theirs, "run", key, Note("theirs", ("a",)))
    notes.write(theirs, "run", other, Note("of the other"))
    notes.write(theirs, "run", OTHER, Note("of a run that nobody has"))
    notes.write(theirs, "study", "toy-study", Note("of the study"))
    notes.write(ours, "run", key, Note("ours"))
    out = labbook("import", theirs.folder, "--lab", ours.folder).output
    assert "Notes imported: 2\n" in out
    assert f"Not replaced: the note of the run {key} in this lab differs and is kept" in out
    assert notes.read(ours, "run", key) == Note("ours")
    assert notes.read(ours, "run", other) == Note("of the other")
    assert notes.read(ours, "run", OTHER) == Note()
    assert notes.read(ours, "study", "toy-study") == Note("of the study")
    notes.write(theirs, "run", key, Note("ours"))
    out = labbook("import", theirs.folder, "--lab", ours.folder).output
    assert "Not" not in out, "nothing is new, and nothing differs"


@pytest.mark.parametrize("harm", [*HARMS, "link"])
def test_a_damaged_note_is_not_imported(full, tmp_path, harm):
    theirs, key, _ = full
    ours = LabFolder(tmp_path / "ours")
    path = notes.note_path(theirs, "run", key)
    notes.write(theirs, "run", key, Note("theirs"))
    if harm == "link":
        path.unlink()
        path.symlink_to("/etc/hostname")
    else:
        HARMS[harm][0](path)
    ended = labbook("import", theirs.folder, "--lab", ours.folder, check=False)
    assert ended.exit_code == 1
    assert f"Not imported: {path}: " in ended.output
    assert "Runs and packings imported: 4\n" in ended.output
    assert len(list(ours.runs.iterdir())) == 2
    assert notes.read(ours, "run", key) == Note()
