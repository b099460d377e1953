"""The web app: what a lab holds, shown in a browser; and the same pages as a folder of files.

It stands on `labbook.results`: it evaluates nothing, and writes nothing but notes.
"""
