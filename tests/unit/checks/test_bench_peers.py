"""Decks of benchmarks/peers for other codes: walls, materials and refusals as text, and forces of the codes if they are
installed; and how flow rates of both sides are measured and compared."""

import math
import shutil
import subprocess

import decks
import numpy as np
import pandas as pd
import pytest
import silo

from labbook.scene import Scene
from labbook.scene.packing import Packing

D = 3e-3
WEDGE = {
    "kind": "wedge-hopper", "width": 0.03, "height": 0.08, "thickness": 0.014, "angle": math.radians(65),
    "orifice": 0.012, "gap": 0.005,
}  # fmt: skip
CONE = {"kind": "conical-silo", "diameter": 0.03, "height": 0.08, "angle": math.radians(45), "orifice": 0.016}
FLAT = {"kind": "cylinder-silo", "diameter": 0.03, "height": 0.08, "orifice": 0.016}
CODES = {"liggghts": "liggghts", "lammps": "lmp"}


def scene(code: str, container: dict, grains: dict | None = None, contact: dict | None = None, **more) -> Scene:
    stated = {"law": f"hertz-{code}", "shear_modulus": 4e6, "poisson_ratio": 0.25, "friction": 0.5, "restitution": 0.5}
    spheres = {"shape": "sphere", "diameter": D, "density": 2500, "count": 2}
    return Scene.model_validate({
        "grains": spheres | (grains or {}), "contact": stated | (contact or {}), "container": container, **more,
    })  # fmt: skip


def resting(*places: tuple[float, float, float], **more) -> Packing:
    x = np.array(places)
    return Packing(x=x, v=np.zeros_like(x), omega=np.zeros_like(x), **more)


BED = resting((-0.01, -0.005, 0.01), (0.01, 0.005, 0.05))


def triangles(text: str) -> np.ndarray:
    """Corners [n, 3, 3] of an STL file."""
    rows = [line.split()[1:] for line in text.splitlines() if line.startswith("vertex")]
    return np.array(rows, float).reshape(-1, 3, 3)


def area(corners: np.ndarray) -> float:
    return float(
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    )


def line(text: str, start: str) -> list[str]:
    """Words of the only line that begins so."""
    (found,) = [words for words in text.splitlines() if words.startswith(start)]
    return found.split()


def test_the_plates_of_an_off_centre_wedge_are_meshes_of_their_size():
    text, files = decks.deck("liggghts", scene("liggghts", WEDGE), BED, 1e-6)
    assert set(files) == {"bed.data", "bottom-left.stl", "bottom-right.stl"}
    depth = np.ptp(BED.x[:, 1]) + 4 * D  # two diameters beside the grains
    for name, run in (("bottom-left", 0.005), ("bottom-right", 0.013)):  # horizontal extents: gap, and the rest
        corners = triangles(files[f"{name}.stl"])
        assert area(corners) == pytest.approx(depth * run / math.sin(math.radians(65)), rel=1e-9)
    lips = [triangles(files[f"bottom-{side}.stl"])[..., [0, 2]].reshape(-1, 2) for side in ("left", "right")]
    assert [corners[corners[:, 1] == 0, 0][0] for corners in lips] == pytest.approx([-0.010, 0.002])
    assert line(text, "fix meshes")[-2:] == ["wall_bottom_left", "wall_bottom_right"]
    assert line(text, "fix wall_left")[-2:] == ["xplane", "-0.015"]


def test_the_same_plates_are_prisms_in_lammps():
    text, _ = decks.deck("lammps", scene("lammps", WEDGE), BED, 1e-6)
    left = [float(word) for word in line(text, "region wall_bottom_left")[3:-2]]
    assert left[:2] == pytest.approx([-0.010, -0.010], abs=decks.THIN)
    assert left[5] == pytest.approx(0.005 / math.tan(math.radians(65)))
    assert left[6:] == pytest.approx([0, -0.005, 0])  # from the lip to the side wall
    assert line(text, "fix wall_right1")[-3:] == ["xplane", "NULL", "0.015"]
    assert line(text, "fix wall_front1")[-3:] == ["yplane", "-0.007", "NULL"]


def test_kinds_and_walls_have_types_of_their_own():
    """Restitutions of LIGGGHTS and LAMMPS that give labbook's C_n back, by their own formulas."""
    kinds = [{"name": "large", "share": 0.5}, {"name": "small", "share": 0.5, "diameter": 2e-3}]
    between = [{"kinds": ["large", "small"], "friction": 0.1}]
    surfaces = {"all": {"friction": 0.3}, "bottom": {"restitution": 0.9}}
    bed = resting((0, 0, 0.03), (0, 0, 0.05), kind=np.array([0, 1]), diameter=np.array([3e-3, 2e-3]))
    mixed = scene("liggghts", CONE, {"kinds": kinds}, {"between": between}, walls=surfaces)
    text, files = decks.deck("liggghts", mixed, bed, 1e-6)
    assert "\n4 atom types\n" in files["bed.data"]
    assert len(line(text, "fix m1")) == 6 + 4
    friction = np.array(line(text, "fix m4")[7:], float).reshape(4, 4)
    assert friction[:2, :2].tolist() == [[0.5, 0.1], [0.1, 0.5]]
    assert (friction[:2, 2:] == 0.3).all()
    gives = np.array(line(text, "fix m3")[7:], float).reshape(4, 4)
    log = math.log(1 / gives[0, 3])
    assert math.sqrt(5 / 6) * log / math.hypot(math.pi, log) == pytest.approx(mixed.contact.damping_ratio(0.9))
    theirs = scene("lammps", CONE, {"kinds": kinds}, {"between": between}, walls=surfaces)
    text, files = decks.deck("lammps", theirs, bed, 1e-6)
    assert "\n2 atom types\n" in files["bed.data"]
    assert [line(text, f"pair_coeff {pair}")[11] for pair in ("1 1", "1 2", "2 2")] == ["0.5", "0.1", "0.5"]
    assert line(text, "fix wall_bottom2")[:5] == ["fix", "wall_bottom2", "kind2", "wall/gran/region", "granular"]


@pytest.mark.parametrize(
    ("code", "container", "contact", "more", "reason"),
    [
        ("liggghts", FLAT, {"shear_modulus": 1e6}, {}, "youngs_modulus.*5 MPa"),
        ("liggghts", FLAT, {"tangential_damping": 0.5}, {}, "tangential_damping"),
        ("lammps", FLAT, {"rolling_friction": 0.01}, {}, "rolling_friction"),
        ("lammps", FLAT, {"restitution": 0.05}, {}, "restitution"),
        ("lammps", {**FLAT, "rotation": 1.0}, {}, {}, "moving walls"),
        ("liggghts", FLAT, {}, {"walls": {"side": {"shear_modulus": 1e9, "poisson_ratio": 0.3}}}, "moduli"),
        ("lammps", FLAT, {"law": "hertz-liggghts"}, {}, "hertz-lammps"),
    ],
)
def test_scenes_that_a_code_cannot_represent_are_refused(code, container, contact, more, reason):
    with pytest.raises(decks.Unsupported, match=reason):
        decks.deck(code, scene(code, container, contact=contact, **more), BED, 1e-6)


def test_the_law_of_a_code_has_the_parameters_of_the_study():
    own = scene("liggghts", FLAT, contact={"law": "hertz-mindlin", "friction": 0.4}).contact
    assert decks.law_of("lammps", own).law == "hertz-lammps"
    changed = decks.law_of("liggghts", own)
    assert (changed.friction, changed.restitution, changed.material) == (0.4, 0.5, own.material)


def test_flow_is_that_between_two_parts_of_the_mass():
    """2 kg/s, then 1 kg/s from 3 kg of 10 on: 1.5 to 6 kg takes 0.75 s and 3 s. A grain that bounces back does not
    count twice."""
    left = pd.DataFrame({"time": [0, 1.5, 2.0, 2.5, 6.5], "left": [10.0, 7.0, 6.5, 6.7, 2.0]})
    assert silo.flow(left.drop(index=3), 10.0, (0.15, 0.6)) == pytest.approx(4.5 / (2.0 + 2.5 - 0.75), rel=1e-12)
    assert silo.flow(left, 10.0, (0.15, 0.6)) == pytest.approx(4.5 / 3.75, rel=1e-12)
    assert math.isnan(silo.flow(left, 10.0, (0.15, 0.81)))


def test_pairs_with_a_clogged_silo_are_counted_apart():
    """Log differences of 1, 2 and 3 %: 2 ± 0.577 %, of which 90 % by Student's t of 2 is 2.92 errors."""
    ours = np.array([100.0, 110.0, 105.0, 100.0])
    theirs = ours * np.exp([0.01, 0.02, 0.03, math.nan])
    result = silo.compared(pd.DataFrame({"ours": 1e-3 * ours, "theirs": 1e-3 * theirs}))
    assert (result["beds"], result["clogged"]) == (3, 1)
    assert result["difference"] == pytest.approx(0.02)
    assert float(result["high"]) - 0.02 == pytest.approx(2.919986 * 0.01 / math.sqrt(3), rel=1e-6)


@pytest.mark.parametrize("container", [WEDGE, CONE, FLAT], ids=["wedge", "cone", "flat"])
@pytest.mark.parametrize("code", CODES)
def test_walls_of_the_codes_push_as_labbooks_do(code, container, tmp_path):
    """Static forces on grains at walls and lips: Hertz's, along the gradient of labbook's distance.

    LAMMPS adds the curvature of round walls to the effective radius: for 1.5 mm in 8 to 15 mm at most 6 %. Meshes of
    LIGGGHTS have 96 corners, and a grain that touches two triangles is pushed by both: 1 in 3 at a cone. Rolling
    friction of LIGGGHTS pushes no grain at rest, but its settings must stand where the code reads them.
    """
    if shutil.which(CODES[code]) is None:
        pytest.skip(f"needs Debian's package {code}")
    rolling = {"rolling_friction": 0.01 if code == "liggghts" else 0.0}
    scenery, r, rng = scene(code, container, contact=rolling), D / 2, np.random.default_rng(1)
    walls, x = scenery.container.walls(), rng.uniform([-0.016, -0.016, -0.002], [0.016, 0.016, 0.03], (100_000, 3))
    x = x[scenery.container.inside(x) | ((x[:, 2] < 0) & scenery.container.lets_out(x))]
    nearest = np.min([wall.shape.distance(x) for wall in walls], axis=0)
    x = x[(nearest < 0.995 * r) & (nearest > 0.97 * r)][:300]
    text, files = decks.deck(code, scenery, resting(*x), 1e-9)
    text = text.replace("neigh_modify delay 0", "neigh_modify delay 0 exclude type 1 1").split("fix down")[0]
    form = ("" if code == "liggghts" else "line ") + '"%d %20.15g %20.15g %20.15g"'
    text += f"dump out all custom 1 dump.txt id fx fy fz\ndump_modify out sort id format {form}\nrun 0\n"
    for name, content in {**files, "in.walls": text}.items():
        (tmp_path / name).write_text(content)
    subprocess.run([CODES[code], "-in", "in.walls", "-log", "none"], cwd=tmp_path, check=True, capture_output=True)
    theirs = np.array([row.split()[1:] for row in (tmp_path / "dump.txt").read_text().splitlines()[-len(x) :]], float)
    stiffness, ours, step = 4 / 3 * (2 * 4e6 * 1.25) / (2 * (1 - 0.25**2)) * math.sqrt(r), np.zeros_like(x), 1e-7
    for wall in walls:
        slope = [wall.shape.distance(x + e) - wall.shape.distance(x - e) for e in step * np.eye(3)]
        overlap = np.maximum(r - wall.shape.distance(x), 0)
        ours += stiffness * (overlap**1.5 * np.array(slope) / (2 * step)).T
    apart = np.linalg.norm(theirs - ours, axis=1) / np.linalg.norm(ours, axis=1)
    assert len(x) > 100
    if code == "lammps":
        assert apart.max() < (0.01 if container is WEDGE else 0.06)
    else:
        assert np.quantile(apart, 1 if container is WEDGE else 0.6) < 1e-6
