"""Progress in a notebook: one output that is updated in place."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from typing import Any

from labbook.run.progress import counts, lines, remaining
from labbook.run.watch import View

_LINE_WIDTH = 110
"""Characters in a line."""


def in_notebook() -> bool:
    """Return True if this process is the kernel of a notebook."""
    interactive = sys.modules.get("IPython")
    shell = interactive.get_ipython() if interactive is not None else None
    return getattr(shell, "kernel", None) is not None


class NotebookBar:
    """Progress of a run below its cell; only lines that must not be missed stay at the end."""

    def __init__(self):
        self._handle: Any = None
        self._lines: list[str] = []
        self._view: View | None = None

    def __enter__(self) -> "NotebookBar":
        from IPython.display import HTML, display  # pyright: ignore[reportMissingImports]

        self._handle = display(HTML(self.html()), display_id=True)
        return self

    def __exit__(self, *_) -> None:
        self._view = None
        self._draw()

    def show(self, view: View) -> None:
        """Draw the present progress."""
        self._view = view
        self._draw()

    def tell(self, line: str) -> None:
        """Add a line above the bar; it is drawn with the next update, since other threads may not draw."""
        self._lines.append(line)

    def html(self) -> str:
        """Return the lines, the bar and the active jobs as HTML."""
        parts = [f"<div>{escape(line)}</div>" for line in self._lines]
        if self._view is not None:
            done, left = self._view.work_done, self._view.work_left
            rate = f"{self._view.rate / 1e6:.1f} M grain-steps/s" if self._view.rate else ""
            status = ", ".join(filter(None, (remaining(self._view), rate)))
            bar = f'<progress value="{done:.6g}" max="{max(done + left, 1.0):.6g}" style="width:20em"></progress>'
            parts.append(f"<div>{escape(counts(self._view))} {bar} {escape(status)}</div>")
            active = "<br>".join(escape(line.strip()) for line in lines(self._view, _LINE_WIDTH))
            parts.append(f'<div style="opacity:0.65">{active}</div>')
        return "".join(parts)

    def _draw(self) -> None:
        if self._handle is not None:
            from IPython.display import HTML  # pyright: ignore[reportMissingImports]

            self._handle.update(HTML(self.html()))


@contextmanager
def counting(label: str) -> Iterator[Callable[[int], None]]:
    """Show a count below the cell; gives a function to call with the number that is done."""
    from IPython.display import HTML, display  # pyright: ignore[reportMissingImports]

    handle: Any = display(HTML(f"<div>{escape(label)} ...</div>"), display_id=True)
    yield lambda done: handle.update(HTML(f"<div>{escape(label)}: {done}</div>"))
    handle.update(HTML(""))
