"""The physics of contacts, written once for every backend.

Its modules are plain Python in the small vocabulary of `labbook_dem.words`. As they stand they run in CPython; a
backend reads their source, puts its own vocabulary in place of `words`, and compiles them (`labbook_dem.source`).
"""
