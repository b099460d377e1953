"""Comparing the toy with its twin on a small study."""

from labbook_toy import Backend, Twin
from toy_lab import study as toy_study
from toy_lab import study_file as toy_study_file

from labbook.checks.compare.compare import compare
from labbook.checks.compare.sides import Side
from labbook.lab import LabFolder, RunRecord
from labbook.lab.folder import stamp

GRAINS = 400  # enough for a bulk to measure the packing fraction in


def study(folder, *more, **changes):
    return toy_study(folder, *more, count=GRAINS, **changes)


def study_file(folder):
    return toy_study_file(folder, count=GRAINS)


def contestants(first=None, second=None):
    return Side(first or Backend(), "cpu"), Side(second or Twin(), "cpu")


def compared(asked, lab, second=None, margin=0.03):
    verdict, failed = compare(asked, LabFolder(lab), contestants(second=second), margin)
    assert not failed
    return verdict


def stamps(lab):
    return {path.name: stamp(path) for kind in ("runs", "packings") for path in (lab / kind).iterdir()}


def records(lab, backend):
    found = map(RunRecord.read, (lab / "runs").iterdir())
    return {(one.label, one.seed): one for one in found if one.backend == backend}


def stamps_of_packings(lab):
    return {path.name: stamp(path) for path in (lab / "packings").iterdir()}
