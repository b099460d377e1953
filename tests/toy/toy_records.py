"""What a toy study left in its lab."""

from labbook.lab import RunRecord


def records(lab) -> dict[tuple[str, int], RunRecord]:
    found = [RunRecord.read(folder) for folder in (lab / "runs").iterdir()]
    return {(record.label, record.seed): record for record in found}


def outcomes(summary) -> list[str]:
    return sorted(summary.tally.ran.values())
