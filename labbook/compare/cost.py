"""What each backend's runs took."""

from collections.abc import Iterable
from statistics import median

from labbook.compare.carry import Session
from labbook.compare.verdict import Cost
from labbook.lab.folder import Lab
from labbook.lab.records import RunRecord, Unreadable


def cost(lab: Lab, backend: str, runs: Iterable[str], session: Session, before: Cost | None) -> Cost:
    """Of the runs with these keys that are there. `before`: what an earlier comparison by the same backend found; its
    session counts if nothing had to be run now."""
    records = []
    for key in dict.fromkeys(runs):
        try:
            records.append(RunRecord.read(lab.run(key)))
        except Unreadable:
            continue
    rates = [record.rate for record in records if record.rate == record.rate]
    if session.grain_steps:
        wall, rate = session.wall_time, session.grain_steps / session.wall_time
    else:
        wall, rate = (before.session_wall, before.session_rate) if before else (None, None)
    return Cost(
        backend=backend,
        devices=tuple(sorted({record.device for record in records})),
        runs=len(records),
        wall_time=sum(record.wall_time for record in records),
        rate=median(rates) if rates else None,
        session_wall=wall,
        session_rate=rate,
    )
