"""Progress in Python: a bar in a terminal or a notebook, warnings where no bar is wanted."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

from labbook.run.notebook import NotebookBar, counting, in_notebook
from labbook.run.progress import Bar
from labbook.run.watch import NullWatcher, Watcher
from labbook.warning import caller, warn


class Quiet(NullWatcher):
    """A watcher that shows nothing; messages that must not be missed become warnings at the line of the user's code."""

    def __init__(self):
        self._caller = caller()  # lines are told from threads of their own

    def tell(self, line: str) -> None:
        """Warn of it."""
        warn(line, self._caller)


def watching(progress: bool | Watcher) -> AbstractContextManager[Watcher]:
    """Return a context that yields the watcher `progress` stands for: a bar, a silent one, or itself."""
    if not isinstance(progress, bool):
        return nullcontext(progress)
    if not progress:
        return nullcontext(Quiet())
    if in_notebook():
        return NotebookBar()
    from rich.console import Console

    return Bar(Console(stderr=True))


@contextmanager
def count_display(progress: bool | Callable[[int], None], title: str) -> Iterator[Callable[[int], None]]:
    """Show a number of finished runs while a context lasts.

    Args:
        progress: True shows the number, False nothing; or a function to call with it.
        title: Title of the count.

    Yields:
        A function to call with the number.
    """
    if not isinstance(progress, bool):
        yield progress
        return
    if progress and in_notebook():
        with counting(title) as count:
            yield count
        return
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not (progress and console.is_terminal)) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done: bar.update(task, completed=done)
