"""`labbook export`: a study's numbers as tables, its recorded runs for ParaView, its packings for other codes."""

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from labbook.cli.options import BACKEND, LAB, Backend, Lab, StudyFile, results
from labbook.cli.screen import say, screen


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def export(
        study: StudyFile,
        out: Annotated[
            Path | None, typer.Option(help="Folder of the files; if not given, LAB/exports/NAME.", show_default=False)
        ] = None,
        kind: Annotated[Literal["csv", "parquet"], typer.Option("--format", help="Format of the tables.")] = "csv",
        vtk: Annotated[
            bool, typer.Option("--vtk", help="Also write recorded frames and mean fields as VTK files.")
        ] = False,
        packings: Annotated[
            bool,
            typer.Option("--packings", help="Also write packings for LIGGGHTS and LAMMPS, and walls as STL."),
        ] = False,
        walls: Annotated[
            bool, typer.Option("--walls", help="Also write the walls of all containers as STL; needs no runs.")
        ] = False,
        facets: Annotated[
            int, typer.Option(min=3, max=10_000, help="Corners of round walls in STL files, on the circle.")
        ] = 96,
        inside: Annotated[
            str | None,
            typer.Option(help="Also write the table inside, N(t): the time between two of its rows, such as '0.1 s'."),
        ] = None,
        headings: Annotated[
            bool, typer.Option("--units", help="Write units into the headings of CSV tables, for spreadsheets.")
        ] = False,
        lab: Lab = LAB,
        backend: Backend = BACKEND,
    ) -> None:
        """Write every number of a study as tables (SI units), and recorded runs as VTK files for ParaView."""

        from labbook.export.packing import NotSpheres
        from labbook.export.study import NoParquet

        results_of_study = results(study, lab, backend)
        folder = out if out is not None else lab / "exports" / results_of_study.study.name
        try:
            with screen(stderr=True).status("writing") as status:
                paths = results_of_study.export(
                    folder, kind, vtk, packings, _seconds(inside), status.update, walls, facets, headings
                )
        except NoParquet as missing:
            raise typer.BadParameter(str(missing), param_hint="--format") from None
        except NotSpheres as rods:
            raise typer.BadParameter(str(rods), param_hint="--packings") from None
        for path in (path for path in paths if path.parent == folder):
            say(path)
        for enabled, name, none in (
            (packings, "packings", "this study has no finished run yet"),
            (walls, "walls", "no wall of this study has a mesh"),
            (vtk, "vtk", "no run of this study kept frames"),
        ):
            if enabled:
                there = [path for path in paths if (folder / name) in path.parents]
                where = f"{len(there)} files in {folder / name}" if there else none
                say(f"{'VTK' if name == 'vtk' else name}: {where}")


def _seconds(text: str | None) -> float | None:
    """A time that was written with its unit [s]."""
    if text is None:
        return None
    from labbook.scene.quantities import parse

    try:
        every = parse(text, "s")
    except ValueError as problem:
        raise typer.BadParameter(f"{text}: {problem}", param_hint="--inside") from None
    if not 0 < every < math.inf:
        raise typer.BadParameter(f"{text}: a time above 0 is needed", param_hint="--inside")
    return every
