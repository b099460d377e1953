"""The physics of contacts, written once for every backend.

Its modules are plain Python in the small vocabulary of `labbook_dem.words`. A backend reads their source, puts its own
vocabulary in place of `words` and one law in place of `chosen`, and compiles them (`labbook_dem.source`). They run in
CPython too, with all switches of `words` on, once a law is chosen (`labbook_dem.chosen.choose`).
"""
