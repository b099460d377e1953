"""Coefficients of laws by name: every law has its own places, and those that all laws share."""

import ast

import pytest
from labbook_dem.coefficients import C_N, COEFFICIENTS, MU, MU_R, OWN, row
from labbook_dem.laws import LAWS, modules_of
from labbook_dem.source import device_source, named_numbers
from one_source import MODULES


def test_shared_places_and_places_of_laws_make_one_row():
    assert sorted((C_N, MU, MU_R, *OWN)) == list(range(COEFFICIENTS))


def test_a_row_has_its_coefficients_by_place():
    assert row({OWN[1]: 7, MU: 0.5}) == (0.0, 0.0, 7.0, 0.0, 0.5, 0.0, 0.0, 0.0)
    with pytest.raises(IndexError):
        row({COEFFICIENTS: 1.0})


@pytest.mark.parametrize("law", LAWS)
def test_no_two_coefficients_of_a_law_share_a_place(law):
    named = named_numbers(modules_of(law))
    assert {"MU", "C_N"} <= set(named)
    assert len(set(named.values())) == len(named)


def test_formulas_index_coefficients_by_names_only():
    for module in MODULES:
        for node in ast.walk(ast.parse(device_source(module))):
            if isinstance(node, ast.Subscript) and ast.unparse(node.value) == "c":
                assert isinstance(node.slice, ast.Name), f"{module.__name__}: {ast.unparse(node)}"
