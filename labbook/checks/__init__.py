"""Checks of backends and machines: verification, stress, benchmarks, comparison, and what is installed."""
