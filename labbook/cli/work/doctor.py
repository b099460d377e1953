"""Installed packages, backends that work here, and tests of a folder that shall hold a lab."""

import json
from dataclasses import asdict
from pathlib import Path

import typer
from rich.markup import escape
from rich.table import Table

from labbook.backend import BackendMissing, Unsupported, load
from labbook.checks import disk
from labbook.checks.doctor import Examination, NoKernel, examine
from labbook.checks.doctor import kernel as kernel_of
from labbook.cli.options import fail, read_study
from labbook.cli.screen import saying, screen
from labbook.plan.demand import Conflict


def doctor(as_json: bool, kernel: Path | None, point: int, backend: str, lab: Path | None, peer: bool) -> None:
    """Examine what is installed, or a kernel, or a folder. Exit status 1 if a test fails."""
    if lab is not None:
        _examine_lab(lab, peer, as_json)
        return
    if peer:
        fail("--peer needs --lab PATH: the folder that both hosts share")
    if kernel is not None:
        typer.echo(_kernel(kernel, point, backend), nl=False)
        return
    with saying("looking around") as say:
        examination = examine(say)
    if as_json:
        print(json.dumps(examination.as_dict(), indent=2))
    else:
        _show(examination)
    if not any(backend.works for backend in examination.backends):
        raise typer.Exit(1)


def _examine_lab(lab: Path, peer: bool, as_json: bool) -> None:
    if not lab.is_dir():
        fail(f"{lab}: no such folder; create it first")
    with saying("free space") as say:
        checks = disk.examine(lab, say)
        if peer:
            checks += disk.meet(lab, say)
    if as_json:
        print(json.dumps([asdict(check) for check in checks], indent=2))
    else:
        _show_checks(lab, checks)
    if not all(check.works for check in checks):
        raise typer.Exit(1)


def _show_checks(lab: Path, checks: list[disk.Check]) -> None:
    table = Table("test", "works", "note", title=escape(str(lab)), title_justify="left")
    for check in checks:
        style = None if check.works else "bold red"
        table.add_row(check.name, "yes" if check.works else "no", escape(check.note), style=style)
    screen().print(table)


def _kernel(study: Path, point: int, backend: str) -> str:
    try:
        return kernel_of(load(backend), read_study(study), point)
    except (BackendMissing, NoKernel, Unsupported, Conflict) as error:
        fail(error)


def _show(examination: Examination) -> None:
    console = screen()
    console.print(
        f"labbook {examination.version}, Python {examination.hardware['python']} on {examination.hardware['processor']}"
    )
    console.print(f"GPU and driver: {examination.hardware['gpu'] or 'none found'}")
    for backend, versions in examination.versions.items():
        console.print(f"{backend}: " + ", ".join(f"{what} {version}" for what, version in versions.items()))
    packages = Table("package", "version", "needed for")
    for package in examination.packages:
        packages.add_row(package.name, package.version or "not installed", package.purpose)
    console.print(packages)
    backends = Table("backend", "device", "description", "works", "precisions", "laws", "note")
    for backend in examination.backends:
        backends.add_row(
            backend.name,
            backend.device,
            backend.what,
            "yes" if backend.works else "no",
            ", ".join(backend.precisions),
            ", ".join(backend.laws),
            escape(backend.note),  # which may name an extra in brackets
        )
    console.print(backends)
