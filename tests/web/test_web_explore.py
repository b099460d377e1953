"""The page that explores a study: its numbers, its tables, and its arithmetic, which is compared with Python's."""

import csv
import io
import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from labbook_web.app import STATIC
from toy_explore import ANSWERS, compare, questions
from toy_lab import labbook
from toy_web import Read, client, make

import labbook as package
from labbook.api import Results
from labbook.study.proposed import study_at

STUDY, PLANE = "toy-study", "plane"
NODE = shutil.which("node")


def results(folder: Path, file: str) -> Results:
    return package.Lab(folder / "lab", backend="toy").results(package.load(folder / file))


@pytest.mark.slow
@pytest.mark.parametrize(("file", "name"), [("toy.yaml", STUDY), ("plane.yaml", PLANE)])
def test_the_arithmetic_of_the_page_is_that_of_python(done, plane, file, name):
    if NODE is None:
        pytest.skip("Node.js is not installed; the tests in Chromium compare the same")
    folder = done if name == STUDY else plane
    surface = results(folder, file).explore()
    view = json.loads(client(folder / "lab").get(f"/study/{name}/explore.json").text)["views"][0]
    designs, targets = questions(surface, np.random.default_rng(1))
    script = (
        f"const surfaces = (() => {{ {(STATIC / 'surface.js').read_text()}; return surfaces; }})();"
        f"console.log(JSON.stringify({ANSWERS.strip()}(...JSON.parse(require('fs').readFileSync(0)))))"
    )
    asked = json.dumps([view, designs, targets])
    ended = subprocess.run([NODE, "-e", script], input=asked, capture_output=True, text=True, timeout=60, check=True)
    compare(surface, json.loads(ended.stdout), designs, targets)


def test_the_page_has_what_python_says(plane):
    surface, page = results(plane, "plane.yaml").explore(), client(plane / "lab").get(f"/study/{PLANE}/explore")
    assert page.status_code == 200
    read = Read(page.text)
    first = read.data["views"][0]
    assert [one["key"] for one in first["factors"]] == ["container.orifice", "container.angle"]
    assert first["method"] == surface.method
    assert {one["n"] for one in first["points"]} == set(range(1, 9))
    clogged = [one for one in first["points"] if not one["used"]]
    assert [one["at"][0] for one in clogged] == [0.008] * 2
    assert all("clogged" in one["clogged"] for one in clogged)
    assert [one["share"] for one in first["influences"]] == pytest.approx([one.share for one in surface.influences])
    text = unescape(page.text)
    for row in (surface.verdict, *surface.notes):
        assert row in text
    table = next(rows for rows in read.rows.values() if rows[0][0] == "D [mm]")
    assert [float(row[0]) for row in table[1:]] == pytest.approx(
        [1e3 * one.at["container.orifice"] for one in surface.next_runs]
    )


def test_the_twins_have_the_surface_at_the_points(plane):
    somebody, surface = client(plane / "lab"), results(plane, "plane.yaml").explore()
    rows = list(csv.DictReader(io.StringIO(somebody.get(f"/study/{PLANE}/explore.csv").text)))
    flows = [row for row in rows if row["quantity"] == "flow_rate"]
    assert len(flows) == len(surface.points) == 6
    for row, point in zip(flows, surface.points, strict=True):
        assert float(row["surface"]) == surface.predict({k: point.at[k] for k in surface.keys})[0]
        assert float(row["surface_low"]) < float(row["surface"]) < float(row["surface_high"])


def test_studies_of_the_page_run_as_they_are(plane, tmp_path):
    """The next runs, and a design at a point that was run: its runs are those that the lab has."""
    page = client(plane / "lab").get(f"/study/{PLANE}/explore")
    following = unescape(re.findall(r'data-copy="(name: plane-next[^"]*)"', page.text)[0])
    path = tmp_path / "next.yaml"
    path.write_text(following)
    assert package.load(path).replicates == 4
    view = Read(page.text).data["views"][0]
    path = tmp_path / "design.yaml"
    path.write_text(f"{view['study']}points:\n- {{container.orifice: 24 mm, container.angle: 40 deg}}\n")
    ended = labbook("plan", path, "--lab", plane / "lab", "--backend", "toy")
    assert "2 done" in ended.output
    assert "to run" not in ended.output


def test_a_point_that_was_run_is_written_as_it_was(plane):
    study = results(plane, "plane.yaml").study
    chosen = [study.points[3], study.points[4]]
    head, points = study_at(study, [one.at for one in chosen], "again", 2)
    assert points == "points:\n- {container.orifice: 18 mm, container.angle: 90 deg}\n" \
                     "- {container.orifice: 24 mm, container.angle: 40 deg}\n"  # fmt: skip
    assert [one.scene for one in _read(head + points).points] == [one.scene for one in chosen]


SHIPPED = sorted((Path(__file__).parents[2] / "studies").glob("fan2023*.yaml"))
SHIPPED += [SHIPPED[0].with_name(f"{name}.yaml") for name in ("pongo2022-maps", "hopper-angle")]


@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda path: path.stem)
def test_points_of_shipped_studies_are_written_as_they_are(shipped):
    """Two of its points as a study of their own: the same scenes, so that the lab has their runs."""
    study = package.load(shipped)
    chosen = [study.points[0], study.points[-1]]
    again = _read("".join(study_at(study, [one.at for one in chosen], "again", 2)))
    assert [(one.scene, one.fill, one.numerics) for one in again.points] == [
        (one.scene, one.fill, one.numerics) for one in chosen
    ]


def _read(text: str):
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.yaml"
        path.write_text(text)
        return package.load(path)


@pytest.mark.slow
def test_the_page_is_linked_and_a_study_of_one_point_has_none(done, tmp_path):
    links = Read(client(done / "lab").get(f"/study/{STUDY}").text).links("href")
    assert f"/study/{STUDY}/explore" in links
    make(tmp_path, orifices="[24]", replicates=2)
    somebody = client(tmp_path / "lab")
    assert f"/study/{STUDY}/explore" not in Read(somebody.get(f"/study/{STUDY}").text).links("href")
    answer = somebody.get(f"/study/{STUDY}/explore")
    assert answer.status_code == 404
    assert "nothing to explore" in answer.text
    assert client(done / "lab").get(f"/study/{STUDY}/explore?no=1").status_code == 400


@pytest.mark.slow
def test_too_few_points_are_told_of(tmp_path):
    make(tmp_path, orifices="[18, 24]", replicates=2)
    page = client(tmp_path / "lab").get(f"/study/{STUDY}/explore")
    assert page.status_code == 200
    assert "2 designs are too few" in page.text
