"""`labbook runs`: the runs in the lab."""

import json
from typing import TYPE_CHECKING, Annotated

import typer

from labbook.cli.options import LAB, AsJson, Lab, existing, fail
from labbook.cli.screen import WIDE, say, screen
from labbook.commands import command

if TYPE_CHECKING:
    from collections.abc import Mapping

    from labbook.lab import LabFolder

OfStudy = Annotated[str | None, typer.Option("--study", help="Only runs that were first made for this study.")]
OfOutcome = Annotated[
    str | None, typer.Option("--outcome", help="Only runs with this outcome, or `unreadable`, or `suspect`.")
]
OfTag = Annotated[str | None, typer.Option("--tag", help="Only runs with this tag in their note.")]
Limit = Annotated[int, typer.Option("--limit", help="Number of runs to list, the latest first; 0: all.", min=0)]


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def runs(
        lab: Lab = LAB,
        study: OfStudy = None,
        outcome: OfOutcome = None,
        tag: OfTag = None,
        limit: Limit = 50,
        as_json: AsJson = False,
    ) -> None:
        """List runs, the latest first, with outcome, flow rate and discharged part of the mass.

        The flow rate is that in the window that opens last, of those of the studies that were evaluated.
        """
        catalogue = existing(lab)
        if absent := catalogue.absent(study, outcome):
            fail(absent)
        if tag is None:
            listed = catalogue.runs(study, outcome, limit or None)
        else:
            listed = catalogue.runs(study, outcome)
            listed = listed[listed.run_key.isin(_with_tag(catalogue.lab, tag))].head(limit or len(listed))
        changed = catalogue.changed(list(listed.run_key))
        if as_json:
            records = json.loads(listed.to_json(orient="records") or "[]")
            typer.echo(json.dumps(records, indent=2, allow_nan=False))
            return
        total = sum(catalogue.counts().values())  # before anything is printed: the index may be damaged
        _show(listed, catalogue.flow_rates(listed.run_key))
        if len(listed) < total:
            say(f"{len(listed)} of {total} runs shown")
        if changed:
            say(
                f"{len(changed)} of these changed since they were indexed, such as {sorted(changed)[0]}; index them "
                f"again: {command('reindex', lab=lab)}",
                err=True,
            )


def _with_tag(lab: "LabFolder", tag: str) -> list[str]:
    """Keys of runs with a tag; notes that cannot be read are named."""
    from labbook.lab.notes import checked, damaged, tagged

    try:
        (label,) = checked([tag])
    except ValueError as problem:
        fail(f"--tag: {problem}")
    for problem in damaged(lab, "run"):
        say(f"Unreadable: {problem}", err=True)
    return [key for key, tags in tagged(lab, "run").items() if label in tags]


def _show(listed, rates: "Mapping[str, float]") -> None:
    """Print runs as a table. On a terminal, study and backend are named once where all runs have the same. `rates`:
    flow rates of runs [kg/s]."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from labbook.scene.quantities import percent

    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    readable = listed[listed["outcome"] != "unreadable"]
    backends = [
        f"{name} {int(version)}" for name, version in zip(readable.backend, readable.cache_version, strict=True)
    ]
    console = screen(highlight=False)
    values = {"study": set(readable.study), "backend": set(backends)} if console.width < WIDE else {}
    shared = {name: some.pop() for name, some in values.items() if len(some) == 1}
    several = bool((listed["discharge"] > 1).any())
    headings = [
        name for name in ("run", "study", "point", "seed", "discharge", "backend", "outcome") if name not in shared
    ]
    if not several:
        headings.remove("discharge")
    headings += ["W [g/s]", "discharged", "t [s]"]
    for heading in headings:
        right = heading in ("seed", "discharge", "W [g/s]", "discharged", "t [s]")
        folded = heading in ("study", "point")  # the others are never cut
        table.add_column(escape(heading), justify="right" if right else "left", no_wrap=not folded, overflow="fold")
    problems, suspects = [], []
    scenes = listed.groupby(["study", "label"])["scene_key"].nunique()
    twice = {point for point, many in scenes.items() if many > 1}
    for row in listed.itertuples(index=False):
        if row.outcome == "unreadable":
            cells = {"run": row.run_key[:10], "outcome": "unreadable"}
            table.add_row(*(cells.get(heading, "") for heading in headings), style="red")
            problems.append(row.problem)
            continue
        cells = {
            "run": row.run_key[:10],
            "study": escape(row.study),
            "point": escape(row.label) + (f" (scene {row.scene_key[:6]})" if (row.study, row.label) in twice else ""),
            "seed": str(int(row.seed)),
            "discharge": str(int(row.discharge)),
            "backend": f"{escape(row.backend)} {int(row.cache_version)}",
            "outcome": f"{row.outcome}, suspect" if row.suspect else row.outcome,
            "W [g/s]": f"{rates[row.run_key] * 1e3:.4g}" if row.run_key in rates else "–",
            "discharged": percent(row.discharged, ".0f"),
            "t [s]": f"{row.duration:.3g}",
        }
        table.add_row(
            *(cells[heading] for heading in headings),
            style="yellow" if row.outcome == "diverged" or row.suspect else None,
        )
        if row.suspect:
            suspects.append(f"{row.run_key[:10]} is suspect: {row.suspect}")
    if shared:
        console.print(", ".join(f"{name} {value}" for name, value in shared.items()), markup=False)
    console.print(table)
    if twice:
        names = ", ".join(sorted({study for study, _ in twice}))
        console.print(
            f"Runs of different studies with one name ({names}): the key of the scene distinguishes their points",
            markup=False,
        )
    for problem in problems:
        console.print(problem, style="red", markup=False)
    for suspect in suspects:
        console.print(suspect, style="yellow", markup=False)
