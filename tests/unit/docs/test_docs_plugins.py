"""The page on extensions names all groups, and all that an entry of each has to define."""

import re

import pytest
from toy_lab import ROOT

from labbook.filling.placing import Start
from labbook.fit import Law
from labbook.measure import Measure
from labbook.papers import Paper
from labbook.plugins import KINDS, required
from labbook.scene import ContactLaw
from labbook.scene.walls import WallShape

PAGE = (ROOT / "docs/plugins.md").read_text(encoding="utf-8")
ROWS = {row.split("`")[1]: row for row in re.findall(r"^\| `labbook\..*$", PAGE, flags=re.MULTILINE)}


def test_every_group_has_a_row():
    assert set(ROWS) == set(KINDS)


@pytest.mark.parametrize(
    ("group", "kind"),
    [
        ("labbook.contact_laws", ContactLaw),
        ("labbook.walls", WallShape),
        ("labbook.starts", Start),
        ("labbook.measures", Measure),
        ("labbook.laws", Law),
        ("labbook.papers", Paper),
    ],
)
def test_the_row_of_a_group_has_the_class_and_all_that_it_leaves_to_define(group, kind):
    names = set(re.findall(r"`([\w.]+)`", ROWS[group]))
    assert any(name.endswith(f".{kind.__name__}") for name in names)
    assert set(required(kind)) <= names


def test_what_may_be_defined_is_there_to_be_defined():
    rows = {"contact law": ContactLaw, "wall": WallShape, "measure": Measure, "flow law": Law}
    for title, kind in rows.items():
        (row,) = re.findall(rf"^\| {title} \|(.*)\|$", PAGE, flags=re.MULTILINE)
        names = [name for name in re.findall(r"`(\w+)`", row) if name not in ("slot", "hole", "any")]
        assert names
        assert all(hasattr(kind, name) for name in names)
