"""Points stand in rows and columns by their swept keys."""

from itertools import product

from labbook.results.placement import placement

ANGLES, WIDTHS, FRICTIONS = (0.3, 1.2), (0.03, 0.01, 0.02), (0.1, 0.5)
POINTS = [{"angle": a, "width": w, "friction": f} for a, w, f in product(ANGLES, WIDTHS, FRICTIONS)]


def test_columns_are_by_the_key_with_most_values_and_of_others_the_first_is_shown():
    found = placement(POINTS)
    assert (found.column, found.row) == ("width", ("angle",))
    assert (found.columns, found.rows) == ((0.01, 0.02, 0.03), ((0.3,), (1.2,)))
    assert found.fixed == {"friction": 0.1}
    for (row, column), number in found.points.items():
        at = POINTS[number]
        assert (at["angle"], at["width"], at["friction"]) == (found.rows[row][0], found.columns[column], 0.1)
    assert len(found.points) == 6


def test_rows_may_have_all_keys_but_that_of_the_columns():
    found = placement(POINTS, row_keys=None)
    assert found.rows == tuple(product(ANGLES, FRICTIONS))
    assert found.fixed == {}
    assert sorted(found.points.values()) == list(range(12))


def test_words_keep_the_order_of_the_study():
    found = placement([{"law": law} for law in ("linear", "hertz")])
    assert (found.column, found.columns, found.rows) == ("law", ("linear", "hertz"), ((),))


def test_points_without_a_key_have_a_row_of_their_own():
    found = placement([{"width": 0.01}, {"width": 0.02}, {"width": 0.03}, {"width": 0.01, "angle": 0.3},
                    {"width": 0.02, "angle": 0.5}])  # fmt: skip
    assert found.rows == ((None,), (0.3,), (0.5,))
    assert found.points == {(0, 0): 0, (0, 1): 1, (0, 2): 2, (1, 0): 3, (2, 1): 4}


def test_a_single_point_has_one_place():
    found = placement([{}])
    assert (found.column, found.columns, found.rows, found.points) == ("", (None,), ((),), {(0, 0): 0})
