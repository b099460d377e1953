"""Measurements from a CSV file: how they are read, and what is wrong with a file."""

import pytest
from toy_lab import study_file

from labbook.study import StudyError, load
from labbook.study.measurements import LARGEST

CSV = """\ufeff# bench of 12 May
container.orifice [mm], value [g/s], error [g/s]
18, 18.9, 0.4
21, 26.5,

24, 34000 mg/s, 0.6
"""


def asked(folder, csv: str = CSV, *more: str, reference: str = "{file: measured.csv}"):
    (folder / "measured.csv").write_text(csv, encoding="utf-8")
    return study_file(folder, f"reference: {reference}", *more)


def entries(path):
    reference = load(path).reference
    assert reference is not None
    return reference.entries


def test_cells_have_the_units_of_their_headings(tmp_path):
    found = entries(asked(tmp_path))
    assert [one.at["container.orifice"] for one in found] == [0.018, 0.021, 0.024]
    assert [one.value for one in found] == pytest.approx([0.0189, 0.0265, 0.034])
    assert [one.error for one in found] == [pytest.approx(4e-4), None, pytest.approx(6e-4)]
    assert {one.quantity for one in found} == {"flow_rate"}
    assert all(one.measured for one in found)
    reference = load(tmp_path / "toy.yaml").reference
    assert reference is not None
    assert reference.source == "measured.csv"


def test_quantities_of_several_units_state_them_in_the_cells(tmp_path):
    csv = "quantity,value,says\nflow_rate,20 g/s,scale\npacking_fraction,0.6,\nbeverloo.k,1.4,line\n"
    path = asked(
        tmp_path, csv, "fit: [beverloo]", reference="{source: Bench, file: measured.csv, beverloo.k: {value: 1.5}}"
    )
    path.write_text(path.read_text().replace("measure: [flow_rate]", "measure: [flow_rate, packing]"))
    found = entries(path)
    assert [(one.quantity, one.value, one.says) for one in found] == [
        ("flow_rate", 0.02, "scale"),
        ("packing_fraction", 0.6, ""),
        ("beverloo.k", 1.4, "line"),
        ("beverloo.k", 1.5, ""),
    ]


@pytest.mark.parametrize(("csv", "line", "says"), [
    ("orifice [mm],value [g/s]\n18,20\n", 1, "did you mean container.orifice"),
    ("container.orifice [mm],flow_rate [g/s]\n18,20\n", 1, "neither a key of a study nor a column"),
    ("container.orifice [mm]\n18\n", 1, "the column `value` is missing"),
    ("container.orifice [mm],value [g/s],value [g/s]\n18,20,21\n", 1, "a second column of this name"),
    ("container.orifice [mm],value [g/s]\n18,18,9\n", 2, "3 cells stand below 2 headings"),
    ("container.orifice [mm],value [g/s]\n18,20\nx,21\n", 3, "at.container.orifice: x"),
    ("container.orifice [mm],value [mm]\n18,20\n", 2, "a quantity in kg/s is needed"),
    ("container.orifice,value [g/s]\n18,20\n", 2, "the unit is missing"),
    ("container.orifice [mm],value [g/s]\n18,-1\n", 2, "a flow rate is above 0"),
    ("container.orifice [mm],value [g/s]\n18,\n", 2, "value: this key is missing"),
    ("quantity,value\nflow_rat,20 g/s\n", 2, "did you mean flow_rate"),
    ("contact.friction,value [g/s]\n0.3,20\n", 2, "another value of contact.friction"),
    ("container.orifice [mm],value [g/s]\n", 1, "no values"),
    ("\n", 1, "no line with headings"),
])  # fmt: skip
def test_what_is_wrong_is_named_with_the_line_of_the_file(tmp_path, csv, line, says):
    with pytest.raises(StudyError) as caught:
        load(asked(tmp_path, csv))
    assert f"measured.csv:{line}: " in str(caught.value)
    assert says in str(caught.value)


@pytest.mark.parametrize("name", ["/etc/passwd", "../measured.csv", "a/../../b.csv", "missing.csv"])
def test_a_file_outside_the_folder_of_the_study_is_refused(tmp_path, name):
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "measured.csv").write_text(CSV)
    with pytest.raises(StudyError) as caught:
        load(asked(inner, reference=f"{{source: x, file: {name}}}"))
    assert "reference.file" in str(caught.value)
    assert "the folder of the study" in str(caught.value)


def test_links_large_files_and_other_encodings_are_refused(tmp_path):
    path, real = asked(tmp_path), tmp_path / "measured.csv"
    real.rename(tmp_path / "real.csv")
    real.symlink_to("real.csv")
    with pytest.raises(StudyError, match="is a link"):
        load(path)
    real.unlink()
    real.write_text("x" * (LARGEST + 1))
    with pytest.raises(StudyError, match="larger than 2 MB"):
        load(path)
    real.write_bytes(CSV.encode("utf-16"))
    with pytest.raises(StudyError, match="not text in UTF-8"):
        load(path)


def test_a_changed_study_keeps_its_measurements(tmp_path):
    study = load(asked(tmp_path))
    assert study.change(replicates=3).reference == study.reference
    assert not study.change(reference=None).beside.files
    (tmp_path / "new").mkdir()
    assert load(study.save(tmp_path / "new/a.yaml")).reference == study.reference
