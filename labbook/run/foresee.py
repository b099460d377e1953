"""A plan with what it will cost and what the study may well want otherwise."""

from dataclasses import replace

from labbook.backend import Backend
from labbook.lab.catalogue import Catalogue
from labbook.run.advice import advice, too_large
from labbook.run.forecast import forecast
from labbook.run.lane import slots
from labbook.run.plan import Plan, Planner, check
from labbook.run.provenance import cores, memory, provenance
from labbook.run.reach import cut_short
from labbook.study import Study


class TooLarge(Exception):
    """The runs do not fit into the memory of this machine; the message has file, key and remedy."""


def foresee(study: Study, catalogue: Catalogue, backend: Backend, device: str) -> Plan:
    """What `study` still needs in a lab, with time and disk on `device`, and warnings.

    Raises Unsupported, Conflict or MeasureError for what cannot be done, TooLarge, ImportError where a package of the
    backend is missing.
    """
    plan = Planner(study, catalogue, backend.capabilities).plan()
    check(backend, device, plan.points)
    lanes = cores() if device == "cpu" else 1
    machine = provenance(device)["machine"]
    ahead = forecast(plan, catalogue, machine, device, lanes, backend, slots(backend, device, plan.points))
    if device == "cpu" and (told := too_large(plan, lanes, memory())):
        raise TooLarge(told)
    warnings = (*cut_short(plan, catalogue.lab), *advice(plan, ahead.seconds))
    return replace(plan, forecast=ahead, warnings=warnings)
