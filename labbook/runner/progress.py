"""A progress bar for people: runs and packings, rate, and the time that is left at that rate."""

import time

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

from labbook.runner.watch import View

_REDRAW = 0.25  # s


class Bar:
    """Shows a run's progress on `console`, if that is a terminal; else shows nothing."""

    def __init__(self, console: Console):
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.fields[runs]}"),
            BarColumn(),
            TextColumn("{task.fields[speed]}"),
            TextColumn("{task.fields[left]}"),
            TextColumn("[dim]{task.fields[going]}[/dim]"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._progress.add_task("", total=1.0, runs="planning", speed="", left="", going="")
        self._shown = 0.0

    def __enter__(self) -> "Bar":
        self._progress.start()
        return self

    def __exit__(self, *_) -> None:
        self._progress.stop()

    def show(self, view: View) -> None:
        """Draw the bar again, at most four times a second."""
        if time.monotonic() - self._shown < _REDRAW:
            return
        self._shown = time.monotonic()
        held = f"; {view.elsewhere} held by another labbook" if view.elsewhere else ""
        self._progress.update(
            self._task,
            completed=view.work_done,
            total=max(view.work_done + view.work_left, 1.0),
            runs=counts(view),
            speed=f"{view.rate / 1e6:.1f} M grain-steps/s" if view.rate else "",
            left=f"about {duration(view.work_left / view.rate)} left" if view.rate else "",
            going=", ".join(view.going[:2]) + ("" if len(view.going) <= 2 else " ...") + held,
        )


def counts(view: View) -> str:
    """Runs done of those asked for, and the packings that have to be made before the rest can start."""
    first = f", {view.fillings_left} packing{'s' if view.fillings_left > 1 else ''} first" if view.fillings_left else ""
    return f"{view.runs_done}/{view.runs_asked} runs{first}"


def duration(seconds: float) -> str:
    """A time span for people, to two figures or so: 40 s, 12 min, 3.5 h, 2.1 d."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 90 * 60:
        return f"{seconds / 60:.0f} min"
    if seconds < 48 * 3600:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 86400:.1f} d"


def size(count: float) -> str:
    """Bytes for people: 40 kB, 1.2 MB, 3.5 GB."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= scale:
            return f"{count / scale:.1f} {unit}"
    return f"{count:.0f} B"
