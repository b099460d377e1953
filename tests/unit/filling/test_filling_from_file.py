"""Starts from files of other codes: what is read, and what is refused."""

# pyright: reportArgumentType=false

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labbook.export.packing import data_file
from labbook.filling import GrainFile, PlacingError, place
from labbook.filling.grain_files import GrainFileError, read_grains
from labbook.scene import (
    CylinderSilo,
    Kind,
    LinearSpringDashpot,
    LogNormal,
    Packing,
    Scene,
    SizeTable,
    Spheres,
    Spherocylinders,
    attached,
)
from labbook.scene.orientation import axes

D = 3e-3
SILO = CylinderSilo(diameter=10 * D, height=60 * D, orifice=5 * D)
LAW = LinearSpringDashpot(normal_stiffness=2000)

DUMP = b"""ITEM: TIMESTEP
0
ITEM: NUMBER OF ATOMS
1
ITEM: BOX BOUNDS pp pp ff
0 1
0 1
0 1
ITEM: ATOMS id type x y z radius
1 1 0 0 0.5 0.001
ITEM: TIMESTEP
100
ITEM: NUMBER OF ATOMS
2
ITEM: BOX BOUNDS pp pp ff
-0.01 0.03
0 0.5
0 2
ITEM: ATOMS id type xs ys zs vx vy vz omegax omegay omegaz radius fx
7 2 0.25 0.002 0.01 0 0 -1 0 5 0 0.001 3.5
3 1 0.25 0.002 0.005 0.1 0.2 0.3 1 2 3 0.0015 -2
"""
DATA = b"""LAMMPS data file, written by hand

2 atoms
2 atom types

-0.1 0.1 xlo xhi
-0.1 0.1 ylo yhi
0 1 zlo zhi

Atoms # sphere

2 1 0.003 2500 0.001 -0.002 0.03 0 0 0
1 2 0.002 1000 0 0 0.01 0 0 1

Velocities

1 0.1 0.2 0.3 1 2 3
2 0 0 -1 0 5 0
"""
CSV = b"""# of a scan
remark, x [mm], y (mm), z [cm], Diameter [um], kind, vx [mm/s], vy [mm/s], vz [m/s]
"a, b", 0, 0, 1, 2000, small, 100, 200, 0.3
, 1, -2, 3, 3000, large, 0, 0, -1
"""


def scene(grains) -> Scene:
    return Scene(grains=grains, contact=LAW, container=SILO).close()


def spheres(count=2, **varied) -> Spheres:
    return Spheres(diameter=D, density=2500, count=count, **varied)


def start(grains, content: bytes | str, shift=(0.0, 0.0, 0.0)) -> Packing:
    content = content.encode() if isinstance(content, str) else content
    return place(scene(grains), "file", 1, GrainFile(attached.add(content), shift))


def csv(x, **columns) -> str:
    heads = ["x [m]", "y [m]", "z [m]", *columns]
    rows = np.column_stack([x, *columns.values()])
    return "\n".join([",".join(heads), *(",".join(f"{number:.17g}" for number in row) for row in rows.tolist())])


def test_the_last_step_of_a_dump_is_read_in_the_order_of_ids():
    table = read_grains(DUMP)
    assert table.x == pytest.approx(np.array([[0, 0.001, 0.01], [0, 0.001, 0.02]]))
    assert table.diameter == pytest.approx([0.003, 0.002])
    assert table.kind is not None
    assert table.kind.tolist() == ["1", "2"]
    assert np.array_equal(table.v, [[0.1, 0.2, 0.3], [0, 0, -1]])
    assert np.array_equal(table.omega, [[1, 2, 3], [0, 5, 0]])


def test_other_columns_of_a_dump_may_be_text_or_repeat():
    dump = DUMP.replace(b"omegax omegay omegaz radius fx", b"element type radius fy fx").replace(
        b"0 5 0 0.001 3.5", b"A 2 0.001 0 1"
    )
    table = read_grains(dump.replace(b"1 2 3 0.0015 -2", b"B 1 0.0015 0 1"))
    assert table.diameter == pytest.approx([0.003, 0.002])
    assert table.omega is None


def test_a_data_file_is_read_in_the_order_of_ids():
    table = read_grains(DATA)
    assert np.array_equal(table.x, [[0, 0, 0.01], [0.001, -0.002, 0.03]])
    assert np.array_equal(table.diameter, [0.002, 0.003])
    assert table.kind is not None
    assert table.kind.tolist() == ["2", "1"]
    assert np.array_equal(table.v, [[0.1, 0.2, 0.3], [0, 0, -1]])
    assert np.array_equal(table.omega, [[1, 2, 3], [0, 5, 0]])


def test_columns_of_a_csv_file_have_their_units():
    table = read_grains(CSV)
    assert table.x == pytest.approx(np.array([[0, 0, 0.01], [0.001, -0.002, 0.03]]))
    assert table.diameter == pytest.approx([0.002, 0.003])
    assert table.kind is not None
    assert table.kind.tolist() == ["small", "large"]
    assert table.v == pytest.approx(np.array([[0.1, 0.2, 0.3], [0, 0, -1]]))
    assert table.omega is None


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"\xff\xfe\x00", "not text"),
        (b"x,y,z\n1,2,3", r"the column x has no unit; write it as x \[mm\]"),
        (b"x [s], y [m], z [m]\n1,2,3", "the column x: a quantity in m is needed"),
        (b"x [m], y [m], x [m]\n1,2,3", "two columns are called x"),
        (b"x [m], y [m]\n1,2", "headings x"),
        (b"x [m], y [m], z [m]\n1,2,3\n1,2\n", "line 3: 2 entries below 3 headings"),
        (b"x [m], y [m], z [m]\n1,2,b\n", "line 2: z: 'b' is not a number"),
        (b"x [m], y [m], z [m], radius [m]\n1,2,3,0\n", "grain 1: its diameter is not above 0"),
        (DUMP.replace(b"0 0.5\n", b"0 0.5 0.1\n"), "the box must be orthogonal"),
        (DUMP.replace(b"7 2 0.25", b"7 1.5 0.25"), "types are not whole numbers"),
        (b"x [m], y [m], z [m]\n1,2,nan\n", "grain 1: z is not finite"),
        (b"x [m], y [m], z [m], vx [m/s]\n1,2,3,4\n", "vx, vy and vz it has x alone"),
        (DUMP.replace(b"ITEM: ATOMS", b"ITEM: ATOM"), "no ITEM: ATOMS"),
        (DUMP[: DUMP.rindex(b"\n3 1") + 1], "line 19: 1 of 2 atoms follow; the dump is cut off"),
        (DUMP.replace(b"omegax omegay omegaz", b"quatw quati quatj"), "ellipsoids"),
        (b"ITEM: UNITS\nlj\n" + DUMP, "in units lj"),
        (b"write_data, units = cgs" + DATA, "in units cgs"),
        (DATA.replace(b"# sphere", b"# ellipsoid"), "line 10: atom style ellipsoid"),
        (DATA + b"\nEllipsoids\n\n1 1 1 2 1 0 0 0\n", "ellipsoids"),
        (DATA.replace(b"\n2 0 0 -1", b"\n3 0 0 -1"), "different ids"),
    ],
)
def test_what_cannot_be_read_is_named(content, message):
    with pytest.raises(GrainFileError, match=message):
        read_grains(content)


@given(st.sampled_from([DUMP, DATA, CSV]), st.data())
@settings(max_examples=150, deadline=None)
def test_a_damaged_file_is_read_or_refused_and_nothing_else(content, data):
    """Bytes are cut out, put in or changed at random places."""
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content)))
        cut = data.draw(st.integers(0, 30))
        content = (
            content[:at]
            + data.draw(st.binary(max_size=6) | st.sampled_from([b"\n", b"nan", b"-", b'"', b","]))
            + content[at + cut :]
        )
    try:
        table = read_grains(content)
    except GrainFileError:
        return
    assert np.isfinite(table.x).all()
    assert table.diameter is None or (table.diameter > 0).all()


def test_our_own_data_file_gives_the_packing_back_bit_for_bit():
    grains = spheres(
        100, kinds=(Kind(name="large", share=0.3, diameter=D), Kind(name="small", share=0.7, diameter=0.7 * D))
    )
    bed = place(scene(grains), "gas", 1)
    again = start(grains, data_file(bed, scene(grains), "title"))
    for name in ("x", "v", "omega", "diameter", "kind"):
        assert np.array_equal(getattr(again, name), getattr(bed, name)), name


def test_rods_of_a_csv_file_have_their_axes():
    rods = Spherocylinders(diameter=D, length=2 * D, density=2500, count=2)
    x = np.array([[0, 0, 2 * D], [0, 0, 5 * D]])
    axis = np.array([[1, 0, 0], [0, 0.6, -0.8]])
    packing = start(rods, csv(x, ax=2 * axis[:, 0], ay=2 * axis[:, 1], az=2 * axis[:, 2]))
    assert packing.q is not None
    assert np.abs(np.sum(axes(packing.q) * axis, axis=1)) == pytest.approx(1)
    with pytest.raises(PlacingError, match="no axes"):
        start(rods, csv(x))
    with pytest.raises(PlacingError, match="the grains are spheres"):
        start(spheres(), csv(x, ax=[1, 1], ay=[0, 0], az=[0, 0]))
    crossed = np.array([[0, 0, 2 * D], [0, 0, 2.5 * D]])
    with pytest.raises(PlacingError, match=r"overlap by 0\.5 d"):
        start(rods, csv(crossed, ax=[1, 0], ay=[0, 1], az=[0, 0]))


X = np.array([[0, 0, 0.5 * D], [0, 0, 1.5 * D]])


def test_a_file_without_velocities_starts_at_rest_and_may_be_shifted():
    packing = start(spheres(), csv(X), (D, 0, 2 * D))
    assert packing.x == pytest.approx(X + np.array([D, 0, 2 * D]))
    assert not packing.v.any()
    assert not packing.omega.any()


def test_grains_outside_are_refused_with_their_place():
    with pytest.raises(PlacingError, match=r"1 grain lies outside .* grain 2 of .* at \(0, 0, -4\.5\) mm"):
        start(spheres(), csv(X * [1, 1, -1] + [0, 0, 1.1 * D] * np.array([[1], [0]])))
    for inward, fits in ((0.04, True), (0.06, False)):  # into the side wall, of 5 % at most
        x = X + np.array([4.5 * D + inward * D, 0, 0])
        if fits:
            start(spheres(), csv(x))
        else:
            with pytest.raises(PlacingError, match="2 grains lie outside"):
                start(spheres(), csv(x))


def test_overlaps_are_refused_above_a_limit():
    start(spheres(), csv(X * [1, 1, 0.96] + [0, 0, 0.02 * D]))
    with pytest.raises(PlacingError, match=r"grains 1 and 2 .* overlap by 0\.06 d, more than 0\.05 d, as 1 pair does"):
        start(spheres(), csv(X * [1, 1, 0.94] + [0, 0, 0.03 * D]))
    small = SizeTable(diameters=(D, D / 2), number_fractions=(0.5, 0.5))
    deep = csv(np.array([[0, 0, 0.5 * D], [0, 0, 1.22 * D]]), **{"diameter [m]": [D, D / 2]})
    with pytest.raises(PlacingError, match=r"overlap by 0\.06 d"):  # of the smaller one
        start(spheres(sizes=small), deep)


@pytest.mark.parametrize(
    ("grains", "columns", "message"),
    [
        (spheres(3), {}, "grains.count: .* has 2 grains, and the study 3; use 2"),
        (spheres(), {"radius [m]": [D / 2, D / 3]}, r"grains.diameter: diameters in .* are 2 to 3 mm, .* 3 mm"),
        (spheres(sizes=LogNormal(median=0.9 * D, spread=0.1, smallest=0.8 * D)), {}, "grains.sizes: .* no diameters"),
        (spheres(kinds=(Kind(name="a", share=0.5), Kind(name="b", share=0.5, density=1e3))), {}, "add a column kind"),
        (
            spheres(kinds=(Kind(name="a", share=0.5), Kind(name="b", share=0.5, density=1e3))),
            {"kind": [1, 3]},
            "has grains of a kind 3",
        ),
    ],
)
def test_grains_of_another_study_are_refused(grains, columns, message):
    with pytest.raises(PlacingError, match=message):
        start(grains, csv(X, **columns))


def test_a_wrong_mean_volume_is_refused_and_scatter_is_not():
    """Of 1000 grains three standard errors and 2 % are 11.5 %."""
    sizes = SizeTable(diameters=(D, D / 2), number_fractions=(0.5, 0.5))
    bed = place(scene(spheres(1000, sizes=sizes)), "rain", 1)
    columns = {"diameter [m]": bed.diameter}
    start(spheres(1000, sizes=sizes), csv(bed.x, **columns))
    other = SizeTable(diameters=(D, D / 2), number_fractions=(0.6, 0.4))
    with pytest.raises(PlacingError, match="the mean volume of a grain"):
        start(spheres(1000, sizes=other), csv(bed.x, **columns))


def test_digits_of_a_file_do_not_make_another_diameter():
    packing = start(spheres(), csv(X, **{"diameter [m]": [D * (1 + 5e-5), D * (1 - 5e-5)]}))
    assert packing.diameter is None


def test_without_the_content_a_start_is_refused():
    with pytest.raises(PlacingError, match="lies in no lab"):
        place(scene(spheres()), "file", 1, GrainFile("0" * 64))
    with pytest.raises(PlacingError, match="needs the file"):
        place(scene(spheres()), "file", 1)
