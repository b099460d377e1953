"""Carrying out a plan: jobs, lanes, checkpoints, stop rules, claims."""
