"""Execution of a plan: jobs, workers, processes, and progress."""
