"""Benchmarks of a backend: how fast it is (`speed`), and how its error depends on the time step (`accuracy`)."""
