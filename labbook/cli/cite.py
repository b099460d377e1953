"""`labbook cite`: what to cite for a study."""

import json
from typing import TYPE_CHECKING, Annotated

import typer

from labbook.cli.options import AsJson, StudyFile, fail, read_study
from labbook.cli.screen import say

if TYPE_CHECKING:
    from labbook.study.citing import Bibliography

AsBibtex = Annotated[bool, typer.Option("--bibtex", help="Print BibTeX.")]


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def cite(study: StudyFile, bibtex: AsBibtex = False, as_json: AsJson = False) -> None:
        """Print what to cite for a study: labbook, and the sources of its contact laws, fits, measures, statistics and
        reference. It needs no finished run."""
        from labbook.study.citing import bibliography

        if bibtex and as_json:
            fail("--bibtex and --json exclude each other; give one of them")
        asked = read_study(study)
        found = bibliography(asked)
        if as_json:
            cited = [{**one.source.plain, "for": list(one.uses)} for one in found.citations]
            shown = {"study": asked.name, "sources": cited, "without_source": list(found.unstated)}
            typer.echo(json.dumps(shown, indent=2, allow_nan=False))
        elif bibtex:
            say("\n\n".join(one.source.bibtex for one in found.citations))
        else:
            _show(asked.name, found)
        if found.unstated and not as_json:
            say(f"No source is stated for {', '.join(found.unstated)}. See the packages that add them.", err=True)


def _show(name: str, found: "Bibliography") -> None:
    say(f"Sources of the study {name}:")
    for one in found.citations:
        say(f"\n[{one.source.key}] {one.source.text}\n    for {'; '.join(one.uses)}")
