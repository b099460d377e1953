"""`labbook status`: what is in the lab, and what is being worked on."""

import json

import typer

from labbook.cli.options import LAB, AsJson, Lab, existing
from labbook.cli.screen import say, screen
from labbook.commands import command

_DAMAGED = 10
"""Damaged files that are listed one by one."""


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def status(lab: Lab = LAB, as_json: AsJson = False) -> None:
        """Count runs (by outcome) and packings, and list running processes and unfinished work."""
        from labbook.lab.journal import unfinished
        from labbook.run.live import running
        from labbook.run.progress import counts as runs_done
        from labbook.run.progress import remaining

        catalogue = existing(lab)
        counts, suspect, packings = catalogue.counts(), catalogue.suspect_count(), catalogue.packing_count()
        works, live = unfinished(catalogue.lab), running(catalogue.lab)
        lost = catalogue.unreadable()
        if as_json:
            plain = {
                "runs": counts,
                "suspect": suspect,
                "packings": packings,
                "damaged": lost,
                "unfinished": [vars(work) for work in works],
                "running": [one.plain() for one in live],
            }
            typer.echo(json.dumps(plain, indent=2, allow_nan=False))
            return
        total = sum(counts.values())
        by = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items()))
        say(f"{total} runs{f' ({by})' if by else ''}, {packings} packings")
        if suspect:
            verb = "run is" if suspect == 1 else "runs are"
            say(f"  {suspect} {verb} suspect: {command('runs', '--outcome', 'suspect', lab=lab)} says why")
        console = screen(highlight=False)
        for problem in lost[:_DAMAGED]:
            console.print(f"  cannot be read: {problem}", style="red", markup=False, soft_wrap=True)
        if len(lost) > _DAMAGED:
            say(f"  and {len(lost) - _DAMAGED} more; {command('status', '--json', lab=lab)} lists all")
        for process in live:
            where = f"{process.backend} on {process.device}, process {process.pid} on {process.host}"
            say(f"  {process.study}: {'; '.join(filter(None, (runs_done(process), remaining(process), where)))}")
        for work in works:
            state = (
                "in progress" if work.claimed else "stopped, resumable" if work.saved else "stopped, starts from step 0"
            )
            if work.failed and not work.claimed:
                state = f"a filling that failed: {work.failed}"
            say(f"  {work.key}  step {work.step}  {state}{f' ({work.problem})' if work.problem else ''}")
