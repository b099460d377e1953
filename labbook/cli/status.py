"""`labbook status`: what is in the lab, and what is being worked on."""

import json

import typer

from labbook.cli.options import LAB, AsJson, Lab, existing
from labbook.cli.screen import say

_MOST = 10
"""Damaged runs that are listed one by one."""


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def status(lab: Lab = LAB, as_json: AsJson = False) -> None:
        """Count runs by outcome and packings, and list running processes and unfinished work."""
        from labbook.lab.journal import unfinished
        from labbook.run.live import running
        from labbook.run.progress import counts as runs_done
        from labbook.run.progress import remaining

        catalogue = existing(lab)
        counts, suspect, packings = catalogue.counts(), catalogue.suspect_count(), catalogue.packing_count()
        works, live = unfinished(catalogue.lab), running(catalogue.lab)
        lost = [entry.problem for entry in catalogue.damaged()]
        if as_json:
            found = {
                "runs": counts,
                "suspect": suspect,
                "packings": packings,
                "unfinished": [vars(work) for work in works],
                "running": [one.plain() for one in live],
            }
            typer.echo(json.dumps(found, indent=2, allow_nan=False))
            return
        total = sum(counts.values())
        by = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items()))
        say(f"{total} runs{f' ({by})' if by else ''}, {packings} packings")
        if suspect:
            verb = "run is" if suspect == 1 else "runs are"
            say(f"  {suspect} {verb} suspect: labbook runs --outcome suspect --lab {lab} says why")
        for problem in lost[:_MOST]:
            say(f"  cannot be read: {problem}")
        if len(lost) > _MOST:
            say(f"  and {len(lost) - _MOST} more, which labbook runs --lab {lab} lists")
        for one in live:
            where = f"{one.backend} on {one.device}, process {one.pid} on {one.host}"
            say(f"  {one.study}: {'; '.join(filter(None, (runs_done(one), remaining(one), where)))}")
        for work in works:
            state = "being worked on" if work.held else "left, resumable" if work.saved else "left, starts afresh"
            say(f"  {work.key}  step {work.step}  {state}{f' ({work.problem})' if work.problem else ''}")
