"""The first page while runs are made, commands to copy, and what a site publishes."""

import re
import shlex
import shutil
from html import unescape
from types import SimpleNamespace

import pytest
from labbook_web.page import Links
from labbook_web.render import fragment
from labbook_web.site import write
from toy_lab import labbook, study_file
from toy_web import client, keys_of

from labbook.lab import LabFolder, notes
from labbook.lab.notes import Note

STUDY = "toy-study"


def attributes(text: str, tag: str) -> str:
    """The attributes of the first element with this tag and an id or class that a test names."""
    found = re.search(rf"<{tag}[^>]*>", text)
    assert found is not None, tag
    return unescape(found[0])


def test_a_card_that_is_not_complete_is_asked_for_as_a_whole(tmp_path, copied):
    """So that the sentence "No finished run yet" and the bar are never of two moments."""
    path = study_file(tmp_path)
    card = client(tmp_path / "lab", [path]).get(f"/card/{STUDY}").text
    assert "No finished run yet" in card
    assert f'hx-get="/card/{STUDY}"' in attributes(card, "article")
    assert "/progress/" not in card, "the bar alone is not asked for"
    complete = client(copied / "lab").get(f"/card/{STUDY}").text
    assert "hx-get" not in complete
    study = client(tmp_path / "lab", [path]).get(f"/study/{STUDY}").text
    assert f'hx-get="/progress/{STUDY}' in study


def test_the_header_of_the_first_page_is_asked_for_too(copied):
    page = client(copied / "lab").get("/").text
    head = re.search(r'<div class="head" id="summary"[^>]*>', page)
    assert head is not None
    assert 'data-hx-get="/"' in head[0]
    assert 'data-hx-select="#summary"' in head[0]


def test_commands_to_copy_are_quoted_and_name_the_lab(copied):
    lab = copied / "my lab"
    shutil.move(copied / "lab", lab)
    somebody, key = client(lab), keys_of(lab)[0][:16]
    (view,) = re.findall(r'data-copy="(labbook view[^"]*)"', somebody.get(f"/run/{key}").text)
    assert shlex.split(unescape(view)) == ["labbook", "view", key, "--lab", str(lab)]
    (run,) = re.findall(r'data-copy="(labbook run[^"]*)"', somebody.get(f"/study/{STUDY}").text)
    kept = str(lab / "study-files" / f"{STUDY}.yaml")
    assert shlex.split(unescape(run)) == ["labbook", "run", kept, "--lab", str(lab), "--backend", "toy"]


def test_tables_and_figures_can_be_saved(copied):
    somebody = client(copied / "lab")
    answer = somebody.get(f"/study/{STUDY}.csv")
    assert answer.headers["content-disposition"].startswith(f'attachment; filename="study-{STUDY}.csv"')
    contents = SimpleNamespace(study=SimpleNamespace(name=STUDY), backend="toy", state="1a")
    shown = {"title": "Patterns", "why": "", "caption": "How beds flow.", "kinds": ("svg",), "table": False}
    figure = fragment("figure.html.j2", Links(), contents=contents, address="patterns", **shown)
    assert "<figcaption>How beds flow.</figcaption>" in figure
    address = f"/study/{STUDY}/figure/patterns.svg?backend=toy&state=1a"
    assert f'<a href="{address}" download="{STUDY}-patterns.svg">' in unescape(figure)


@pytest.mark.slow
def test_a_site_has_notes_only_if_that_is_said(copied):
    lab, key = copied / "lab", keys_of(copied / "lab")[0]
    notes.write(LabFolder(lab), "study", STUDY, Note("The referee must not see this.", ("draft",)))
    notes.write(LabFolder(lab), "run", key, Note("Nor this.", ("odd",)))

    def published(folder) -> str:
        return "".join(path.read_text() for path in folder.rglob("*.*") if path.suffix in (".html", ".json", ".csv"))

    ended = labbook("site", copied / "out", copied / "toy.yaml", "--lab", lab)
    assert "--notes publishes them" in ended.stderr
    assert not re.search(r"referee|Nor this|draft|odd\b", published(copied / "out"))
    ended = labbook("site", copied / "out", copied / "toy.yaml", "--lab", lab, "--notes")
    assert "Notes and tags are published" in ended.stderr
    assert re.search(r"referee", published(copied / "out"))
    assert "draft" in published(copied / "out")


def test_without_notes_nothing_is_said_of_them(done, tmp_path):
    write(tmp_path / "out", done / "lab", [done / "toy.yaml"])
    assert "left out" not in labbook("site", tmp_path / "out", done / "toy.yaml", "--lab", done / "lab").stderr
