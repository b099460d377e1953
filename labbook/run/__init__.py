"""Carrying out a plan: jobs, lanes, processes, and progress."""
