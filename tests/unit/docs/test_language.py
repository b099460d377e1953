"""`make lint` counts unclear names and docstrings."""

import json

import language
import pytest

LONG = "\n".join(f"    x = {number}" for number in range(4))
CLEAR = "".join(f'\n\ndef size{number}(n):\n    """Size."""\n    return n' for number in range(150))
"""Modules with few other names are far below the ceilings."""


@pytest.mark.parametrize(
    ("source", "counted"),
    [
        (f"def told(n):\n{LONG}", ["told"]),
        (f"def size(one, *, _found):\n{LONG}", ["one", "_found"]),
        (f"def size(n):\n    for kept in n:\n        pass\n{LONG}", ["kept"]),
        (f"class Run:\n    def __init__(self):\n        self.made = 1\n{LONG.replace('x', '    self.x')}", ["made"]),
        (f"import os as known\n{LONG.replace('    ', '')}", ["known"]),
        (f"total = [\n    one\n    for one\n    in x\n]\n{LONG.replace('    ', '')}", ["one"]),
    ],
)
def test_names_count_in_scopes_of_more_than_three_lines(source, counted):
    assert [place.text for place in language.places(source) if place.kind == "names"] == counted


@pytest.mark.parametrize(
    "source",
    [
        "def size(one):\n    return one.size\n",
        f"total = sum(one.size for one in runs)\n{LONG.replace('    ', '')}",
        f"def size(run):\n    print(run.found, other)\n{LONG}",
        f"def one_run(found_keys):\n{LONG}",
    ],
)
def test_short_scopes_uses_and_names_of_several_words_do_not_count(source):
    assert not language.places(source)


@pytest.mark.parametrize(
    ("source", "counted"),
    [
        ('"""What it is."""', 1),
        ('def f():\n    """Whether it is so."""', 1),
        ('X = 1\n"""`How` it is."""', 1),
        ('def f():\n    """Mass [kg]."""', 0),
        ('f("x")\n"""what is no docstring"""', 0),
    ],
)
def test_docstrings_count_by_their_first_word(source, counted):
    assert len(language.places(source)) == counted


def test_a_count_that_grows_is_named_and_a_new_room_may_have_none():
    allowed = {"labbook/run": {"names": 2, "docstrings": 5}, "labbook/gone": {"names": 1, "docstrings": 0}}
    now = {"labbook/run": {"names": 3, "docstrings": 4}, "labbook/new": {"names": 0, "docstrings": 1}}
    grown, fallen = language.compare(now, allowed)
    assert [line.split(";")[0] for line in grown] == [
        "labbook/new: 1 docstrings, 0 allowed",
        "labbook/run: 3 names, 2 allowed",
    ]
    assert fallen == ["labbook/gone: 0 names instead of 1", "labbook/run: 4 docstrings instead of 5"]


def test_what_is_written_is_what_is_read(tmp_path, monkeypatch, capsys):
    module = tmp_path / "run.py"
    module.write_text(f"def told(one):\n{LONG}{CLEAR}")
    monkeypatch.setattr(language, "COUNTS", tmp_path / "counts.json")
    monkeypatch.setattr(language, "rooms", lambda: {"labbook/run": [module]})
    assert language.main(["--write"]) == 0
    assert language.main([]) == 0
    assert "as before" in capsys.readouterr().out
    assert json.loads(language.COUNTS.read_text()) == {"labbook/run": {"names": 2, "docstrings": 0}}
    module.write_text(f"def told(one, more):\n{LONG}{CLEAR}")
    assert language.main([]) == 1
    assert "language: labbook/run: 3 names, 2 allowed" in capsys.readouterr().out


def test_a_share_above_its_ceiling_fails_whatever_the_file_allows(tmp_path, monkeypatch, capsys):
    assert language.CEILINGS == {"names": 1.5, "docstrings": 3.0}
    sources = [CLEAR + '\n\ndef size(one):\n    """What it is."""\n    return one']
    assert language.shares(sources) == {"names": 100 / 302, "docstrings": 100 / 151}
    module = tmp_path / "run.py"
    module.write_text(CLEAR + 5 * '\n\ndef told(one):\n    """How it is."""\n    return one')
    monkeypatch.setattr(language, "COUNTS", tmp_path / "counts.json")
    monkeypatch.setattr(language, "rooms", lambda: {"labbook/run": [module]})
    assert language.main(["--write"]) == 0
    assert language.main([]) == 1
    out = capsys.readouterr().out
    assert "3.23 % of all names, 1.5 % allowed" in out
    assert "3.23 % of all docstrings, 3.0 % allowed" in out
