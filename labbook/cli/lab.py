"""What verbs that look into a lab share: the option of a device, progress of what takes a while."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

from labbook.cli.screen import screen

Device = Annotated[str, typer.Option("--device", help="Device to run on, as the backend names it.")]


@contextmanager
def saying(what: str) -> Iterator[Callable[[str], None]]:
    """What is going on, on standard error: in one line that changes on a terminal, elsewhere line by line with the
    time since the beginning. Gives a function to call with the next."""
    import time

    from rich.console import Console

    from labbook.run.progress import duration

    console, begun = Console(stderr=True, markup=False), time.monotonic()
    if console.is_terminal:
        with console.status(what) as status:
            yield status.update
        return

    def say(text: str) -> None:
        typer.echo(f"{duration(time.monotonic() - begun):>6}: {text}", err=True)

    say(what)
    yield say


@contextmanager
def ticking(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on a terminal: a function to call with how many of how many are done."""
    from rich.progress import Progress

    console = screen(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
