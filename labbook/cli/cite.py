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
    """Add the command to the app."""

    @app.command()
    def cite(study: StudyFile, bibtex: AsBibtex = False, as_json: AsJson = False) -> None:
        """Print what to cite for a study: labbook, and the sources of its contact laws, fits, measures, statistics and
        reference. It needs no finished run."""
        from labbook.study.citing import bibliography

        if bibtex and as_json:
            fail("--bibtex and --json exclude each other; give one of them")
        definition = read_study(study)
        sources = bibliography(definition)
        if as_json:
            cited = [{**citation.source.plain, "for": list(citation.uses)} for citation in sources.citations]
            plain = {"study": definition.name, "sources": cited, "without_source": list(sources.unsourced)}
            typer.echo(json.dumps(plain, indent=2, allow_nan=False))
        elif bibtex:
            say("\n\n".join(citation.source.bibtex for citation in sources.citations))
        else:
            _show(definition.name, sources)
        if sources.unsourced and not as_json:
            say(f"No source is stated for {', '.join(sources.unsourced)}. See the packages that add them.", err=True)


def _show(name: str, sources: "Bibliography") -> None:
    say(f"Sources of the study {name}:")
    for citation in sources.citations:
        say(f"\n[{citation.source.key}] {citation.source.text}\n    for {'; '.join(citation.uses)}")
