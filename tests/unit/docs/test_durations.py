"""Budgets of the time that tests take."""

from pathlib import Path

import durations

ROOT = Path(__file__).parents[3]
FOLDERS = {durations.folder_of(path.relative_to(ROOT).as_posix()) for path in (ROOT / "tests").rglob("test_*.py")}


def test_each_budget_is_of_a_folder_and_all_fit_into_two_cores_for_twenty_minutes():
    assert set(durations.BUDGETS) <= FOLDERS
    total = sum(durations.BUDGETS.get(folder, durations.OTHER) for folder in FOLDERS)
    assert total <= 2 * 20 * 60 - 120, "pyright, linters and collecting tests take about two minutes of the cores"


def test_a_folder_over_its_budget_is_named_and_the_slowest_tests_are_listed():
    contract = durations.BUDGETS["tests/contract"]
    times = [("tests/contract/test_a.py::test_x[1]", contract - 1.0), ("tests/contract/test_b.py::test_y", 1.5)]
    times += [(f"tests/unit/stats/test_c.py::test_{number}", 0.1) for number in range(50)]
    text, over = durations.report(times)
    assert over == ["tests/contract"]
    assert f"52 tests, {contract + 5.5:.0f} s" in text
    slowest = text.partition("slowest 30 tests\n")[2].splitlines()
    assert len(slowest) == 30
    assert slowest[0].split() == [f"{contract - 1:.1f}", "s", "tests/contract/test_a.py::test_x[1]"]
