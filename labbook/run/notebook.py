"""Progress in a notebook: one output that is drawn anew."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from typing import Any

from labbook.run.progress import counts, lines, remaining
from labbook.run.watch import View

_WIDE = 110
"""Characters of a line."""


def in_notebook() -> bool:
    """Whether this process is the kernel of a notebook."""
    interactive = sys.modules.get("IPython")
    shell = interactive.get_ipython() if interactive is not None else None
    return getattr(shell, "kernel", None) is not None


class NotebookBar:
    """Shows a run's progress below the cell that runs it; at the end only lines that must not be missed stay."""

    def __init__(self):
        self._handle: Any = None
        self._told: list[str] = []
        self._view: View | None = None

    def __enter__(self) -> "NotebookBar":
        from IPython.display import HTML, display  # pyright: ignore[reportMissingImports]

        self._handle = display(HTML(self.html()), display_id=True)
        return self

    def __exit__(self, *_) -> None:
        self._view = None
        self._draw()

    def show(self, view: View) -> None:
        """Draw where things stand."""
        self._view = view
        self._draw()

    def tell(self, line: str) -> None:
        """Keep a line above the bar; it is drawn with what comes next, since other threads may not draw."""
        self._told.append(line)

    def html(self) -> str:
        """What is shown now."""
        parts = [f"<div>{escape(line)}</div>" for line in self._told]
        if self._view is not None:
            done, left = self._view.work_done, self._view.work_left
            rate = f"{self._view.rate / 1e6:.1f} M grain-steps/s" if self._view.rate else ""
            said = ", ".join(filter(None, (remaining(self._view), rate)))
            bar = f'<progress value="{done:.6g}" max="{max(done + left, 1.0):.6g}" style="width:20em"></progress>'
            parts.append(f"<div>{escape(counts(self._view))} {bar} {escape(said)}</div>")
            going = "<br>".join(escape(line.strip()) for line in lines(self._view, _WIDE))
            parts.append(f'<div style="opacity:0.65">{going}</div>')
        return "".join(parts)

    def _draw(self) -> None:
        if self._handle is not None:
            from IPython.display import HTML  # pyright: ignore[reportMissingImports]

            self._handle.update(HTML(self.html()))


@contextmanager
def counting(what: str) -> Iterator[Callable[[int], None]]:
    """A function to call with how many are done; shown below the cell meanwhile."""
    from IPython.display import HTML, display  # pyright: ignore[reportMissingImports]

    handle: Any = display(HTML(f"<div>{escape(what)} ...</div>"), display_id=True)
    yield lambda done: handle.update(HTML(f"<div>{escape(what)}: {done}</div>"))
    handle.update(HTML(""))
