"""`labbook bench`: how fast a backend is on this machine."""

import json
from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.screen import saying


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def bench(
        backend: Annotated[str, typer.Option(help="Backend to measure.")] = "numba",
        repeats: Annotated[int, typer.Option(min=1, help="Times that each rate is measured.")] = 5,
        quick: Annotated[bool, typer.Option("--quick", help="Only Fan's hopper; a minute or two.")] = False,
        full: Annotated[bool, typer.Option("--full", help="Also rods in every precision.")] = False,
        out: Annotated[Path | None, typer.Option(help="Also write the figures to this JSON file.")] = None,
        as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    ) -> None:
        """Measure grain-steps per second on Fan's hopper, in three dimensions and of rods.

        One member runs on one core. Takes some five minutes on a slow machine, most of them compiling.
        """
        from labbook.backend import BackendMissing, Unsupported
        from labbook.bench import run

        if quick and full:
            raise typer.BadParameter("--quick and --full: one at a time")
        try:
            with saying("preparing") as say:
                result = run(backend, repeats, say, "quick" if quick else "full" if full else "usual")
        except BackendMissing as error:
            raise typer.BadParameter(str(error), param_hint="--backend") from None
        except Unsupported as error:
            raise typer.BadParameter(error.remedy, param_hint="--backend") from None
        text = json.dumps(result.as_dict(), indent=2)
        if out:
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(text + "\n", encoding="utf-8")
        if as_json:
            print(text)
        else:
            _show(result)


def _show(result) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("case", "grains", "precision", "million grain-steps/s/core", "range")
    for rate in result.rates:
        table.add_row(
            rate.case, str(rate.grains), rate.precision, f"{rate.median:.1f}", f"{rate.low:.1f}-{rate.high:.1f}"
        )
    console = Console()
    console.print(f"backend {result.backend} on {result.hardware['processor']}, {result.hardware['cores']} cores")
    console.print(table)
    large = f"one large scene on all cores: {result.large:.2f} times one thread; " if result.large else ""
    console.print(
        f"{result.members} members side by side: {result.speed_up:.2f} times one; {large}"
        f"peak memory {result.memory:.0f} MB"
    )
