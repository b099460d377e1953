"""Checks that a wrong backend cannot pass: analysis, conservation laws, symmetries, independent integration.

The cases ship with labbook (`labbook verify`) and know a backend only by the contract in `labbook.backend`;
`labbook.checks.verify.cases.CASES` lists them.
"""
