"""Progress on a terminal: runs and packings, rate, remaining time, and active jobs.

A terminal shows it in place, in its width; the least important parts are left out first. Elsewhere a line is written at
the start of each phase, and every half minute, in the width that COLUMNS states.
"""

import time
from collections.abc import Iterable, Sequence
from contextlib import suppress

from rich.console import Console, ConsoleOptions, RenderResult
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from labbook.run.watch import ActiveJob, Phase, View
from labbook.scene.quantities import duration

_MAX_JOBS = 3
"""Maximum number of jobs that are shown singly."""
_LINE_INTERVAL = 30.0  # s between two lines where there is no terminal
_LINE_WIDTH = 120
"""Characters of a line where there is no terminal, if COLUMNS states no other width."""
_MIN_REMAINING = 5.0  # s
_MIN_LOWER_BOUND = 60.0  # s: a lower bound of the time left
NARROWEST, WIDEST = 12, 40  # of the bar
_COMMON_PHASES: tuple[Phase, ...] = ("compiling", "preparing")
"""Phases in which all jobs wait for the same thing."""


class Bar:
    """Progress of a run on `console`: a bar on a terminal, lines elsewhere."""

    def __init__(self, console: Console):
        self._console, self._view = console, None
        self._is_live = console.is_terminal and not console.is_dumb_terminal
        self._spinner = Spinner("dots")
        self._live = Live(self, console=console, transient=True, refresh_per_second=4) if self._is_live else None
        self._start_time = time.monotonic()
        self._last_line = float("-inf")
        self._phase_times: dict[Phase, float] = {}

    def __enter__(self) -> "Bar":
        self._start_time = time.monotonic()
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *_) -> None:
        if self._live:
            with suppress(OSError, SystemExit):  # the terminal is gone, and nobody looks
                self._live.stop()

    def show(self, view: View) -> None:
        """Draw the progress, or write a line if one is due."""
        self._view = view
        if not self._is_live:
            self._write_if_due(view)

    def tell(self, line: str) -> None:
        """Print a line above the bar."""
        if self._live:
            self._console.print(line, highlight=False, markup=False)
        else:
            self._write(line)

    def _write_if_due(self, view: View) -> None:
        if not (view.going or view.elsewhere):
            return  # nothing is waited for
        now = time.monotonic()
        phases: set[Phase] = {job.phase for job in view.going if job.phase != "writing"}  # which comes with every run
        is_new = any(now - self._phase_times.get(phase, float("-inf")) > _LINE_INTERVAL for phase in phases)
        self._phase_times |= dict.fromkeys(phases, now)
        if is_new or now - self._last_line >= _LINE_INTERVAL:
            self._last_line = now
            since = f"{duration(now - self._start_time):>6}: "
            self._write(f"{since}{one_line(view, min(self._console.width, _LINE_WIDTH) - len(since))}")

    def _write(self, line: str) -> None:
        with suppress(OSError):  # nobody reads it any more
            self._console.file.write(line + "\n")
            self._console.file.flush()

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = options.max_width - 1  # a full line would wrap on some terminals
        if self._view is None:
            yield self._spinner
            return
        counts_text, words = heading(self._view, width)
        grid = Table.grid(padding=(0, 1, 0, 0))
        grid.add_row(self._spinner, *self._first_line(counts_text, words, width))
        yield grid
        for line in lines(self._view, width):
            yield Text(line, style="dim", no_wrap=True, overflow="ellipsis")

    def _first_line(self, counts_text: str, words: str, width: int) -> "Iterable[Text | ProgressBar]":
        assert self._view is not None
        yield Text(counts_text, no_wrap=True, overflow="ellipsis")
        room = width - 2 - len(counts_text) - (len(words) + 1 if words else 0) - 1
        if room >= NARROWEST:
            done, left = self._view.work_done, self._view.work_left
            yield ProgressBar(total=max(done + left, 1.0), completed=done, width=min(room, WIDEST))
        if words:
            yield Text(words, no_wrap=True, overflow="ellipsis")


def heading(view: View, width: int) -> tuple[str, str]:
    """Return the texts left and right of the bar, leaving room for the bar; on the right the rate is dropped first."""
    counts_text = counts(view)
    if len(counts_text) > width - 2:
        return f"{counts_text[: width - 3]}…", ""
    rate = f"{view.rate / 1e6:.1f} M grain-steps/s" if view.rate else ""
    for parts in ((remaining(view), rate), (remaining(view),)):
        words = ", ".join(filter(None, parts))
        if 2 + len(counts_text) + 1 + NARROWEST + 1 + len(words) <= width:
            return counts_text, words
    return counts_text, ""


def lines(view: View, width: int) -> list[str]:
    """List the first active jobs, a line each, and the number of others."""
    texts = [f"  {text}" for text in _common_lines(view.going, width - 2)]
    single = [job for job in view.going if job.phase not in _COMMON_PHASES]
    texts += [f"  {fitted(job.label, job.says, width - 2)}" for job in single[:_MAX_JOBS]]
    if len(single) > _MAX_JOBS:
        phases = [job.phase for job in single[_MAX_JOBS:]]
        kinds = ", ".join(f"{phases.count(phase)} {phase}" for phase in dict.fromkeys(phases))
        texts.append(f"  and {kinds}")
    if view.elsewhere:
        texts.append(f"  {view.elsewhere} held by another process")
    return texts


def _common_lines(going: Iterable[ActiveJob], width: int) -> list[str]:
    """Combine jobs that wait for the same thing in one line: reason, some names, number of others."""
    texts = []
    for phase in _COMMON_PHASES:
        waiting = [job for job in going if job.phase == phase]
        if waiting:
            names = [job.label for job in waiting]
            name_lists = [
                _list(names[:count], len(names) - count) for count in range(min(len(names), _MAX_JOBS), 0, -1)
            ]
            reason = "; ".join(waiting[0].says)
            texts.append(next((f"{reason}: {n}" for n in name_lists if len(reason) + 2 + len(n) <= width), reason))
    return texts


def _list(names: Sequence[str], more: int) -> str:
    return "; ".join(names) + (f" and {more} more" if more else "")


def fitted(label: str, parts: Sequence[str], width: int) -> str:
    """Format `LABEL: PART; PART` in at most `width` characters: parts are dropped from the end, then the label is cut
    in its middle."""
    for count in range(len(parts), 0, -1):
        line = f"{label}: {'; '.join(parts[:count])}"
        if len(line) <= width:
            return line
    room = max(width - len(parts[0]) - 2, 9)
    if len(label) > room:
        label = f"{label[: room - room // 2 - 1]}…{label[-(room // 2) :]}"
    return f"{label}: {parts[0]}"[:width]


def one_line(view: View, width: int = _LINE_WIDTH) -> str:
    """Format the progress as one line of at most `width` characters; active jobs are left out first, then the rate."""
    rate = f"{view.rate / 1e6:.1f} M grain-steps/s" if view.rate else ""
    heads = [(counts(view), rate, remaining(view)), (counts(view), remaining(view)), (counts(view),)]
    fitting = (line for head in heads if len(line := "; ".join(filter(None, head))) <= width)
    line = next(fitting, counts(view)[:width])
    for job in map(str.strip, lines(view, width)):
        room = width - len(line) - 2
        if len(job) > room:
            return f"{line}; {job[: room - 1]}…" if room >= NARROWEST else line
        line += f"; {job}"
    return line


def counts(view: View) -> str:
    """Format the number of runs done and demanded, and of packings that have to be made first."""
    first = f", {view.fillings_left} packing{'s' if view.fillings_left > 1 else ''} first" if view.fillings_left else ""
    return f"{view.runs_done}/{view.runs_asked} runs{first}"


def remaining(view: View) -> str:
    """Format the remaining time; empty while the rate is unknown."""
    left = view.seconds_left
    if left is None:
        return ""
    if not view.open_ended:
        return f"about {duration(left)} left" if left >= _MIN_REMAINING else "a few seconds left"
    return f"at least {duration(left)} left" if left >= _MIN_LOWER_BOUND else "time left unknown"
