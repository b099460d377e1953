"""The web app: pages of a lab in a browser, and the same pages as a folder of files.

It stands on `labbook.results`: it evaluates nothing, and writes nothing but notes.
"""
