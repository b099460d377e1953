"""The physics of contacts, written once for every engine.

Its modules are plain Python in the small vocabulary of `labbook_dem.words`. As they stand they run in CPython; an
engine reads their source, puts its own vocabulary in place of `words`, and compiles them (`labbook_dem.source`).
"""
