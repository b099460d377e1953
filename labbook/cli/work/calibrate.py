"""A study carried out until its parameters are known, and the parameters."""

import json
from collections.abc import Sequence
from pathlib import Path

import typer

from labbook.api import Lab
from labbook.campaign import Calibrate
from labbook.cli.options import GO_ON, STOPPED, fail, read_study, results
from labbook.cli.screen import print_table, say, screen
from labbook.cli.work.run import carry_out
from labbook.report.calibrated import experiment_table, parameter_table, sensitivity_table
from labbook.results.calibrated import CalibrationResults, NoPosterior

SUFFIX = ".material.yaml"


def run(study: Path, lab: Path, backend: str, device: str, runs: bool, card: Path | None, as_json: bool) -> None:
    """Make the runs that are missing, and print the parameters that agree with the measurements."""
    definition = read_study(study)
    if not isinstance(definition.adapt, Calibrate):
        fail(f"{definition.name} has no `calibrate` section; the effect of numerics is measured by labbook pilot")
    try:
        if runs:
            summary = carry_out(definition, Lab(lab, backend, device))
            if summary.stopped:
                say(f"Stopped early; everything is saved: {GO_ON}", err=True)
                raise typer.Exit(STOPPED)
        study_results = results(study, lab, backend)
        calibration = study_results.calibration()
    except NoPosterior as problem:
        fail(problem)
    path = card or study.with_suffix(SUFFIX)
    if not calibration.lacking:
        path.write_text(calibration.card(), encoding="utf-8")
    if as_json:
        plain = {**calibration.plain(), "campaign": list(study_results.campaign)}
        typer.echo(json.dumps(plain, indent=2, allow_nan=False))
    else:
        _show(calibration, path, study_results.campaign)
    if calibration.lacking:
        raise typer.Exit(1)


def _show(calibration: CalibrationResults, path: Path, campaign: Sequence[str]) -> None:
    console = screen(highlight=False, markup=False)
    print_table(console, parameter_table(calibration), "Parameters")
    for line in calibration.lines():
        console.print(f"{line}.", soft_wrap=True)
    if campaign:
        console.print(f"{campaign[-1]}.", soft_wrap=True)
    if not calibration.lacking:
        print_table(console, sensitivity_table(calibration), "Sobol indices over the priors")
        print_table(console, experiment_table(calibration), "Next experiments")
        console.print(f"Written: {path}; use it in a study as include: {path.name}", soft_wrap=True)
