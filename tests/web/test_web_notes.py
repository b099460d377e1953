"""Notes are the only thing that the web app writes: who may, what is kept, and what is said of the rest."""

import pytest
from toy_web import HOST, client, keys_of, listing

from labbook.lab import LabFolder, notes
from labbook.lab.notes import Note

STUDY = "toy-study"
OURS = {"origin": f"http://{HOST}"}
"""What a browser sends with a form of our own pages."""


def test_a_note_is_a_file_and_is_shown(copied):
    lab = copied / "lab"
    somebody = client(lab)
    key = keys_of(lab)[0]
    for kind, name, page in (("study", STUDY, f"/study/{STUDY}"), ("run", key[:16], f"/run/{key[:16]}")):
        sent = {"text": "The outlet\r\nlooked odd; 5 ± 1 %.", "tags": "odd, for-the-paper"}
        answer = somebody.post(f"/note/{kind}/{name}", data=sent, headers=OURS)
        assert answer.status_code == 200
        assert "Saved in the lab" in answer.text
        kept = notes.read(LabFolder(lab), "study", STUDY) if kind == "study" else notes.read(LabFolder(lab), "run", key)
        assert kept == Note("The outlet\nlooked odd; 5 ± 1 %.", ("for-the-paper", "odd"))
        shown = somebody.get(page).text
        assert "looked odd; 5 ± 1 %." in shown
        assert "for-the-paper" in shown
    assert "for-the-paper" in somebody.get(f"/card/{STUDY}").text
    assert "odd" in somebody.get("/runs").text
    somebody.post(f"/note/study/{STUDY}", data={"text": " ", "tags": ""}, headers=OURS)
    assert not notes.note_path(LabFolder(lab), "study", STUDY).exists()


def test_tags_that_cannot_be_are_refused_and_nothing_is_lost(copied):
    somebody = client(copied / "lab")
    before = listing(copied / "lab")
    for tags in ("two words", "a" * 31, "<b>", ",".join(f"t{k}" for k in range(21))):
        answer = somebody.post(f"/note/study/{STUDY}", data={"text": "mine", "tags": tags}, headers=OURS)
        assert answer.status_code == 400
        assert "Not saved" in answer.text
        assert ">mine</textarea>" in answer.text, "what was written can be corrected"
    assert {name for name in listing(copied / "lab") if "notes" in name} == {name for name in before if "notes" in name}


def test_notes_of_what_is_not_there_are_refused(copied):
    somebody = client(copied / "lab")
    for address in ("/note/study/none", "/note/run/ffffffffffff", "/note/lab/x", "/note/point/toy-study"):
        assert somebody.post(address, data={"text": "x"}, headers=OURS).status_code == 404, address
    assert somebody.post("/note/run/zz", data={"text": "x"}, headers=OURS).status_code == 400
    assert somebody.get(f"/note/study/{STUDY}").status_code == 405
    assert not (copied / "lab/notes").exists()


def test_nothing_is_noted_where_reading_is_all(copied):
    notes.write(LabFolder(copied / "lab"), "study", STUDY, Note("an old one", ("kept",)))
    somebody = client(copied / "lab", read_only=True)
    answer = somebody.post(f"/note/study/{STUDY}", data={"text": "x"}, headers=OURS)
    assert answer.status_code == 403
    assert "--read-only" in answer.text
    assert notes.read(LabFolder(copied / "lab"), "study", STUDY).text == "an old one"
    page = somebody.get(f"/study/{STUDY}").text
    assert "an old one" in page
    assert "hx-post" not in page


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"origin": "http://elsewhere.example"},
        {"origin": "null"},
        {"origin": f"http://{HOST}:81"},
        {"origin": f"http://{HOST}.example"},
        {**OURS, "sec-fetch-site": "cross-site"},
        {**OURS, "sec-fetch-site": "same-site"},
    ],
    ids=str,
)
def test_other_sites_cannot_write_notes(copied, headers):
    somebody = client(copied / "lab")
    answer = somebody.post(f"/note/study/{STUDY}", data={"text": "x"}, headers=headers)
    assert answer.status_code == 403
    assert not (copied / "lab/notes").exists()
    ours = {**OURS, "sec-fetch-site": "same-origin"}
    assert somebody.post(f"/note/study/{STUDY}", data={"text": "x"}, headers=ours).status_code == 200


def test_a_note_that_cannot_be_read_is_said(copied):
    path = notes.note_path(LabFolder(copied / "lab"), "study", STUDY)
    path.parent.mkdir(parents=True)
    path.write_bytes(b"\xff\xfe\x00")
    somebody = client(copied / "lab")
    assert somebody.get("/").status_code == 200
    assert "cannot be read" in somebody.get(f"/study/{STUDY}").text
