"""Tables of reports on a terminal."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from labbook.report.tables import Table

_BESIDE = 3
"""Columns of a terminal between two of a table."""


def print_table(console: "Console", table: "Table", title: str) -> None:
    """Print a table of a report with its title and notes; marked rows are bold. No number is cut off: where there is no
    room for all beside each other, they wrap between value and error."""
    from rich import box
    from rich.cells import cell_len
    from rich.markup import escape
    from rich.table import Table as Shown

    shown = Shown(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD)
    columns = zip(table.headings, *table.rows, strict=True)
    numbers = sum(max(map(cell_len, cells)) for place, cells in enumerate(columns) if place not in table.text)
    crowded = numbers + _BESIDE * len(table.headings) > console.width
    for place, heading in enumerate(table.headings):
        words = place in table.text
        side = "left" if words else "right"
        shown.add_column(escape(heading), justify=side, no_wrap=not (words or crowded), overflow="fold")
    for place, row in enumerate(table.rows):
        shown.add_row(*map(escape, row), style="bold" if place in table.marked else None)
    console.print(shown)
    for note in table.notes:
        console.print(note, style="dim", markup=False)
