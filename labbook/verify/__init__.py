"""Checks that a wrong engine cannot pass: analysis, conservation laws, symmetries, independent integration.

The cases ship with labbook (`labbook verify`) and know an engine only by the contract in `labbook.backend`;
`labbook.verify.cases.CASES` lists them.
"""
