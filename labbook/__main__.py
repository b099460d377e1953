"""`python -m labbook`: the command line of this very installation."""

from labbook.cli import main

main()
