"""Attempts to break a backend: extreme steps, stiffnesses, speeds, sizes and geometries (`labbook stress`).

Each case ends right, or with a named error and a kept last good state. The cases ship with labbook and know a backend
only by the contract in `labbook.backend`; `labbook.checks.stress.cases.CASES` lists them.
"""
