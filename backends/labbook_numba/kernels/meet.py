"""Synchronisation of the threads that step one scene."""

import numpy as np
from labbook_dem.words import func

from labbook_numba.kernels.features import BROKEN, DOMAINS, NUMBER, kernel
from labbook_numba.meeting import arrive, arrived, give_way
from labbook_numba.state import State


@kernel
def wait_for_domains(meetings, domains):
    """Wait until all domains have arrived; return False if one has failed and never will."""
    # the counter is never reset: the goal is the next multiple of the number of domains
    goal = (arrive(meetings) // domains + 1) * domains
    while arrived(meetings) < goal:
        give_way()
    return arrived(meetings) < BROKEN


@kernel
def largest_of_domains(domain, shared_values, meetings, column, value):
    """Largest of the values of all domains; NaN if one of them is NaN, or if a domain has failed.

    All domains end on NaN, since no check passes it. A domain may write the same column again only after a call for
    another column: it is the barrier that tells that all have read this one.
    """
    domains = domain[DOMAINS]
    if domains > 1:
        shared_values[domain[NUMBER], column] = value
        if not wait_for_domains(meetings, domains):
            return np.nan
        for k in range(domains):
            domain_value = shared_values[k, column]
            if domain_value != domain_value:  # NaN, which `max` would drop or keep by the order of its arguments
                return domain_value
            value = max(value, domain_value)
    return value


@func
def domain_maximum(st: State, column, value):
    """Largest of the values of all domains, or NaN if one is NaN; column: OVERLAP or SPEED."""
    return largest_of_domains(st.domain, st.shared_values, st.meetings, column, value)
