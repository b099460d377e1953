"""`labbook bench`: how fast a backend is on this machine."""

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from labbook.cli.lab import saying


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def bench(
        what: Annotated[
            Literal["backend", "batch", "elongation", "fields"],
            typer.Argument(
                help="backend: one member a core. batch: many members on one device. elongation: rods of several "
                "aspect ratios. fields: coarse-graining."
            ),
        ],
        backend: Annotated[
            str | None, typer.Option(help="Backend to measure.", show_default="numba; for batch, warp")
        ] = None,
        device: Annotated[str, typer.Option(help="GPU that a backend is measured on, where it has one.")] = "cuda:0",
        repeats: Annotated[int, typer.Option(min=1, help="Times that each rate is measured.")] = 5,
        quick: Annotated[bool, typer.Option("--quick", help="backend: only Fan's hopper; a minute or two.")] = False,
        full: Annotated[
            bool, typer.Option("--full", help="backend: also rods in every precision, and what each switch saves.")
        ] = False,
        out: Annotated[Path | None, typer.Option(help="Also write the figures to this JSON file.")] = None,
        as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    ) -> None:
        """Measure grain-steps per second on Fan's hopper, in three dimensions and of rods.

        `backend` takes some five minutes on a slow machine, most of them compiling; `--full` more than twice that.
        `fields`: seconds that fields of 10 000 rods in 100 frames take.
        """
        from labbook.backend import BackendMissing, Unsupported
        from labbook.bench import batch, elongation, fields
        from labbook.bench.backend import run as speed_of

        if (quick or full) and (what != "backend" or quick == full):
            raise typer.BadParameter("--quick and --full are for `backend`, one at a time")
        try:
            with saying("preparing") as say:
                if what == "fields":
                    result = fields.run(say=say)
                elif what == "batch":
                    result = batch.run(backend or "warp", device, say=say)
                elif what == "elongation":
                    name = backend or "numba"
                    result = elongation.run(name, "cpu" if name == "numba" else device, repeats, say)
                else:
                    extent = "quick" if quick else "full" if full else "usual"
                    result = speed_of(backend or "numba", repeats, say, extent)
        except BackendMissing as error:
            raise typer.BadParameter(str(error), param_hint="--backend") from None
        except Unsupported as error:
            raise typer.BadParameter(error.remedy, param_hint=f"--{error.key}") from None
        text = json.dumps(result.as_dict(), indent=2)
        if out:
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(text + "\n", encoding="utf-8")
        if as_json:
            print(text)
        elif isinstance(result, fields.FieldsBench):
            _show_fields(result)
        elif isinstance(result, batch.BatchBench):
            _show_batch(result)
        elif isinstance(result, elongation.ElongationBench):
            _show_elongation(result)
        else:
            _show(result)


def _show_fields(result) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("grid", "grains", "frames", "s", "s of all cores", "contacts", "s", "s of all cores")
    for one in result.timings:
        cells = (one.grains, one.frames, one.wall, one.process, one.contacts, one.contacts_wall, one.contacts_process)
        table.add_row(one.grid, *(f"{cell:.2f}" if isinstance(cell, float) else str(cell) for cell in cells))
    console = Console()
    console.print(f"fields on {result.threads} threads of {result.hardware['processor']}")
    console.print(table)


def _show_batch(result) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(
        *("scene", "members", "grains", "precision", "skin [d]", "threads a grain", "us/step", "1e9 grain-steps/s"),
        *("bytes a grain-step", "of the copy bandwidth"),
    )
    for timing in result.timings:
        load = timing.load
        table.add_row(
            timing.scene,
            str(timing.members),
            str(timing.grains),
            timing.precision,
            f"{timing.skin:g}",
            str(load.lanes) if load else "",
            f"{timing.step:.2f}",
            f"{timing.rate:.2f}",
            f"{load.bytes:.0f}" if load else "",
            f"{timing.fraction:.0%}" if timing.fraction else "",
        )
    console = Console()
    console.print(f"backend {result.backend} on {result.device} ({result.hardware.get('gpu') or 'no GPU'})")
    console.print(table)


def _show_elongation(result) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("L/d", "members", "grains", "ns a grain-step", "range", "times the first's", "(L/d)²")
    for case in result.cases:
        times, square = f"{case.cost / result.cases[0].cost:.2f}", f"{case.aspect_ratio**2:.3g}"
        cost, span = f"{case.cost:.3g}", f"{case.low:.3g}-{case.high:.3g}"
        table.add_row(f"{case.aspect_ratio:g}", str(case.members), str(case.grains), cost, span, times, square)
    console = Console()
    console.print(f"backend {result.backend} on {result.device} ({result.hardware.get('gpu') or 'a core'})")
    console.print(table)


def _show(result) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("case", "grains", "precision", "million grain-steps/s/core", "range")
    for rate in result.rates:
        table.add_row(
            rate.case, str(rate.grains), rate.precision, f"{rate.median:.1f}", f"{rate.low:.1f}-{rate.high:.1f}"
        )
    tables = [table]
    if result.savings:
        tables.append(Table("fan settled, double", "times as fast", "range"))
        for saving in result.savings:
            tables[1].add_row(saving.case, f"{saving.times:.2f}", f"{saving.low:.2f}-{saving.high:.2f}")
    console = Console()
    console.print(f"backend {result.backend} on {result.hardware['processor']}, {result.hardware['cores']} cores")
    console.print(*tables)
    start = result.starting
    large = f"one large scene on all cores: {result.large:.2f} times one thread; " if result.large else ""
    console.print(
        f"{result.members} members side by side: {result.speed_up:.2f} times one; {large}"
        f"peak memory {result.memory:.0f} MB; from process start to the backend's first step {start.first_step:.1f} s, "
        f"of which opening and stepping {start.cached:.2f} s; {start.compiled:.1f} s if it must compile"
    )
