"""Tables of reports on a terminal."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from labbook.report.tables import Table

_BESIDE = 3
"""Columns of a terminal between two of a table."""


def print_table(console: "Console", table: "Table", title: str) -> None:
    """Print a table of a report with its title and notes; marked rows are bold. No number is cut off: where there is no
    room for all beside each other, they wrap between value and error, and text between words."""
    from rich import box
    from rich.cells import cell_len
    from rich.markup import escape
    from rich.table import Table as Shown

    shown = Shown(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD)
    columns = list(zip(table.headings, *table.rows, strict=True))
    whole = [max(map(cell_len, cells)) for cells in columns]
    words = [max(map(cell_len, " ".join(cells).split()), default=0) for cells in columns]
    spare = console.width - _BESIDE * len(columns) - 1 - sum(words)
    widths: list[int | None] = [None] * len(columns)
    if spare >= 0:
        lacks = [most - least for most, least in zip(whole, words, strict=True)]
        order = sorted(range(len(columns)), key=lambda k: (k in table.text, lacks[k]))
        for place, k in enumerate(order):  # numbers come first; of text what lacks least, so that the longest share
            grant = min(lacks[k], spare // (len(order) - place) if k in table.text else spare)
            widths[k] = words[k] + grant
            spare -= grant
    for k, heading in enumerate(table.headings):
        justify = "left" if k in table.text else "right"
        shown.add_column(escape(heading), justify=justify, overflow="fold", width=widths[k])
    for place, row in enumerate(table.rows):
        shown.add_row(*map(escape, row), style="bold" if place in table.marked else None)
    console.print(shown)
    for note in table.notes:
        console.print(note, style="dim", markup=False)
