"""`labbook bench`: how fast a backend is here, what its skips save, and how its errors depend on the time step."""

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from labbook.cli.screen import saying, screen


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def bench(
        benchmark: Annotated[
            Literal["speed", "accuracy", "skips"],
            typer.Argument(help="speed: grain-steps per second; accuracy: errors by dt; skips: time saved."),
        ] = "speed",
        backend: Annotated[str, typer.Option(help="Backend to measure.")] = "numba",
        repeats: Annotated[
            int | None, typer.Option(min=1, help="speed, skips: repeats of each measurement.  [default: 5]")
        ] = None,
        quick: Annotated[
            bool, typer.Option("--quick", help="speed: only Fan's hopper; accuracy: only spheres, two laws, no bed.")
        ] = False,
        full: Annotated[bool, typer.Option("--full", help="speed: also rods in every precision.")] = False,
        precision: Annotated[
            str | None,
            typer.Option(help="accuracy, skips: precision to measure in.  [default: all; skips: double]"),
        ] = None,
        device: Annotated[
            str | None, typer.Option(help="accuracy, skips: device to measure on.  [default: cpu]")
        ] = None,
        out: Annotated[Path | None, typer.Option(help="Also write the numbers to this JSON file.")] = None,
        as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    ) -> None:
        """Measure the speed of a backend, the time saved by leaving out unused features, or errors by time step.

        Speed: grain-steps per second in Fan's hopper, in three dimensions and for rods. One member runs on one core.
        Takes some five minutes on a slow machine, most of them compiling.

        Accuracy: velocities and spins after impacts against SciPy, by contact law and precision, and dense beds of
        spheres and rods against a step 32 times as small. Takes some ten minutes, and one with --quick.

        Skips: features that the scene does not need and the backend leaves out are put back one by one: the time each
        costs, and whether the final state is the same. Takes some five minutes, most of them compiling.
        """
        from labbook.backend import BackendMissing, Unsupported

        if quick and full:
            raise typer.BadParameter("--quick and --full exclude each other; give one of them")
        of_others = {
            "speed": {"--precision": precision, "--device": device},
            "accuracy": {"--repeats": repeats, "--full": full or None},
            "skips": {"--quick": quick or None, "--full": full or None},
        }
        for name, value in of_others[benchmark].items():
            if value is not None:
                raise typer.BadParameter(f"it does not apply to {benchmark}; leave it out", param_hint=name)
        try:
            with saying("preparing") as say:
                if benchmark == "speed":
                    from labbook.checks.bench import speed

                    extent = "quick" if quick else "full" if full else "usual"
                    result = speed.run(backend, repeats or 5, say, extent)
                elif benchmark == "skips":
                    from labbook.checks.bench import skips

                    result = skips.run(backend, repeats or 5, device or "cpu", precision or "double", say)
                else:
                    from labbook.checks.bench import accuracy

                    result = accuracy.run(backend, precision, device or "cpu", quick, say)
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
            {"speed": _show_speed, "accuracy": _show_accuracy, "skips": _show_skips}[benchmark](result)


def _show_speed(result) -> None:
    from rich.table import Table

    table = Table("case", "grains", "precision", "million grain-steps/s/core", "range")
    for rate in result.rates:
        table.add_row(
            rate.case, str(rate.grains), rate.precision, f"{rate.median:.1f}", f"{rate.low:.1f}-{rate.high:.1f}"
        )
    console = screen()
    console.print(f"backend {result.backend} on {result.hardware['processor']}, {result.hardware['cores']} cores")
    console.print(table)
    large = f"one large scene on all cores: {result.large:.2f} times the speed of one thread; " if result.large else ""
    console.print(
        f"{result.members} members side by side: {result.speed_up:.2f} times the speed of one; {large}"
        f"peak memory {result.memory:.0f} MB"
    )


def _show_skips(result) -> None:
    from rich.table import Table

    table = Table("put back", "relative time", "range", "state")
    for feature in result.saved:
        state = "bitwise equal" if feature.same else f"within {feature.difference:.0e} d"
        table.add_row(feature.name, f"{feature.times:.2f}", f"{feature.low:.2f}-{feature.high:.2f}", state)
    table.add_row("fall of a rain, not of a dense start", f"{result.fall:.2f}", "", "other beds; in steps of a filling")
    console = screen()
    console.print(
        f"backend {result.backend}, {result.precision}, {result.device} on {result.hardware['processor']}; "
        f"{'' if result.scenes == 1 else f'{result.scenes} times '}{result.grains} grains of Fan's hopper"
    )
    console.print(table)


def _show_accuracy(result) -> None:
    from rich.table import Table

    console = screen()
    console.print(f"backend {result.backend} on {result.hardware['processor']}; errors relative to the impact speed")
    at = [n for n in (20, 40, 160) if n in result.contacts[0].steps]
    table = Table("impact", "law", "precision", *(f"t_c/{n}" for n in at), "order")
    for contact in result.contacts:
        errors = (f"{contact.error[contact.steps.index(n)]:.1e}" for n in at)
        table.add_row(contact.situation, contact.law, contact.precision, *errors, _order(contact.order))
    console.print(table)
    if not result.beds:
        return
    table = Table("bed", "precision", *(f"x [d], t_c/{n}" for n in result.beds[0].steps[:3]), "order", "v", "growth")
    for bed in result.beds:
        errors = (f"{e:.1e} ({far:.0e})" for e, far in zip(bed.position[:3], bed.farthest[:3], strict=True))
        orders = _order(bed.order), _order(bed.order_velocity)
        table.add_row(bed.bed, bed.precision, *errors, *orders, f"{bed.growth:.1f}")
    console.print(table)
    console.print("beds: median (largest) error of positions; growth of a small change of the initial state")


def _order(order) -> str:
    return "-" if order.value != order.value else f"{order.value:.2f} ± {order.error:.2f}"
