"""Tables of reports on a terminal."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from labbook.report.tables import Table


def print_table(console: "Console", table: "Table", title: str) -> None:
    """Print a table of a report with its title and notes; marked rows are bold."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table as Shown

    shown = Shown(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD)
    for place, heading in enumerate(table.headings):
        words = place in table.text
        shown.add_column(escape(heading), justify="left" if words else "right", no_wrap=not words)
    for place, row in enumerate(table.rows):
        shown.add_row(*map(escape, row), style="bold" if place in table.marked else None)
    console.print(shown)
    for note in table.notes:
        console.print(note, style="dim", markup=False)
