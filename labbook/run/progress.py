"""Progress for people: runs and packings, rate, the time that is left, and what every job is at.

On a terminal it is drawn anew in place, as wide as the terminal is; what does not fit is left out, the least important
first. Elsewhere a line is written at the start of each phase, and every half minute, as wide as COLUMNS says.
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

from labbook.run.watch import Going, Phase, View
from labbook.scene.quantities import duration

_JOBS = 3
"""Jobs that are shown one by one."""
_SPOKEN_EVERY = 30.0  # s between two lines where there is no terminal
_LINE = 120
"""Characters of a line where there is no terminal, if COLUMNS states no other width."""
_FEW = 5.0  # s
_WORTH_SAYING = 60.0  # s: a lower bound of the time left
NARROWEST, WIDEST = 12, 40  # of the bar
_TOGETHER: tuple[Phase, ...] = ("compiling", "preparing")
"""Phases in which all jobs wait for the same."""


class Bar:
    """Shows a run's progress on `console`: a bar on a terminal, lines elsewhere."""

    def __init__(self, console: Console):
        self._console, self._view = console, None
        self._drawn = console.is_terminal and not console.is_dumb_terminal
        self._spinner = Spinner("dots")
        self._live = Live(self, console=console, transient=True, refresh_per_second=4) if self._drawn else None
        self._begun = time.monotonic()
        self._spoken = float("-inf")
        self._seen: dict[Phase, float] = {}

    def __enter__(self) -> "Bar":
        self._begun = time.monotonic()
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *_) -> None:
        if self._live:
            with suppress(OSError, SystemExit):  # the terminal is gone, and nobody looks
                self._live.stop()

    def show(self, view: View) -> None:
        """Draw, or write a line if one is due."""
        self._view = view
        if not self._drawn:
            self._speak(view)

    def tell(self, line: str) -> None:
        """Print a line above the bar."""
        if self._live:
            self._console.print(line, highlight=False, markup=False)
        else:
            self._write(line)

    def _speak(self, view: View) -> None:
        if not (view.going or view.elsewhere):
            return  # nothing is waited for
        now = time.monotonic()
        phases: set[Phase] = {one.phase for one in view.going if one.phase != "writing"}  # which comes with every run
        new = any(now - self._seen.get(phase, float("-inf")) > _SPOKEN_EVERY for phase in phases)
        self._seen |= dict.fromkeys(phases, now)
        if new or now - self._spoken >= _SPOKEN_EVERY:
            self._spoken = now
            since = f"{duration(now - self._begun):>6}: "
            self._write(f"{since}{spoken(view, min(self._console.width, _LINE) - len(since))}")

    def _write(self, line: str) -> None:
        with suppress(OSError):  # nobody reads it any more
            self._console.file.write(line + "\n")
            self._console.file.flush()

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = options.max_width - 1  # a full line would wrap on some terminals
        if self._view is None:
            yield self._spinner
            return
        counted, words = heading(self._view, width)
        grid = Table.grid(padding=(0, 1, 0, 0))
        grid.add_row(self._spinner, *self._first_line(counted, words, width))
        yield grid
        for line in lines(self._view, width):
            yield Text(line, style="dim", no_wrap=True, overflow="ellipsis")

    def _first_line(self, counted: str, words: str, width: int) -> "Iterable[Text | ProgressBar]":
        assert self._view is not None
        yield Text(counted, no_wrap=True, overflow="ellipsis")
        room = width - 2 - len(counted) - (len(words) + 1 if words else 0) - 1
        if room >= NARROWEST:
            done, left = self._view.work_done, self._view.work_left
            yield ProgressBar(total=max(done + left, 1.0), completed=done, width=min(room, WIDEST))
        if words:
            yield Text(words, no_wrap=True, overflow="ellipsis")


def heading(view: View, width: int) -> tuple[str, str]:
    """Words on the left and right of the bar, with room for the bar: of the right ones the rate goes first."""
    counted = counts(view)
    if len(counted) > width - 2:
        return f"{counted[: width - 3]}…", ""
    rate = f"{view.rate / 1e6:.1f} M grain-steps/s" if view.rate else ""
    for parts in ((remaining(view), rate), (remaining(view),)):
        words = ", ".join(filter(None, parts))
        if 2 + len(counted) + 1 + NARROWEST + 1 + len(words) <= width:
            return counted, words
    return counted, ""


def lines(view: View, width: int) -> list[str]:
    """What jobs are at, a line each: of some first ones, and how many more there are."""
    found = [f"  {shared}" for shared in _together(view.going, width - 2)]
    others = [one for one in view.going if one.phase not in _TOGETHER]
    found += [f"  {fitted(one.label, one.says, width - 2)}" for one in others[:_JOBS]]
    if len(others) > _JOBS:
        phases = [one.phase for one in others[_JOBS:]]
        kinds = ", ".join(f"{phases.count(phase)} {phase}" for phase in dict.fromkeys(phases))
        found.append(f"  and {kinds}")
    if view.elsewhere:
        found.append(f"  {view.elsewhere} held by another process")
    return found


def _together(going: Iterable[Going], width: int) -> list[str]:
    """Jobs that wait for the same in one line: what for, some first names as there is room, and how many more there
    are."""
    found = []
    for phase in _TOGETHER:
        waiting = [one for one in going if one.phase == phase]
        if waiting:
            names = [one.label for one in waiting]
            options = [_list(names[:shown], len(names) - shown) for shown in range(min(len(names), _JOBS), 0, -1)]
            said = "; ".join(waiting[0].says)
            found.append(next((f"{said}: {n}" for n in options if len(said) + 2 + len(n) <= width), said))
    return found


def _list(names: Sequence[str], more: int) -> str:
    return "; ".join(names) + (f" and {more} more" if more else "")


def fitted(label: str, says: Sequence[str], width: int) -> str:
    """`LABEL: PART; PART` in at most `width` characters: parts go first, from the last one, then the label's middle."""
    for shown in range(len(says), 0, -1):
        line = f"{label}: {'; '.join(says[:shown])}"
        if len(line) <= width:
            return line
    room = max(width - len(says[0]) - 2, 9)
    if len(label) > room:
        label = f"{label[: room - room // 2 - 1]}…{label[-(room // 2) :]}"
    return f"{label}: {says[0]}"[:width]


def spoken(view: View, width: int = _LINE) -> str:
    """Everything in one line of at most `width` characters: what jobs are at goes first, then the rate."""
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
    """Runs done of those asked for, and the packings that have to be made before the rest can start."""
    first = f", {view.fillings_left} packing{'s' if view.fillings_left > 1 else ''} first" if view.fillings_left else ""
    return f"{view.runs_done}/{view.runs_asked} runs{first}"


def remaining(view: View) -> str:
    """How long it will take; nothing as long as the rate is not known."""
    left = view.seconds_left
    if left is None:
        return ""
    if not view.open_ended:
        return f"about {duration(left)} left" if left >= _FEW else "a few seconds left"
    return f"at least {duration(left)} left" if left >= _WORTH_SAYING else "time left unknown"
