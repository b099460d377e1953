"""Commands of labbook as messages and pages name them: lines that a shell takes as they are."""

import shlex

DEFAULT_BACKEND = "numba"
"""Backend that a command uses if it names none."""


def command(name: str, *words: object, lab: object = None, backend: str = DEFAULT_BACKEND) -> str:
    """The line `labbook NAME WORDS --lab LAB`, with every word quoted that a shell would take apart.

    lab: folder of the lab; None only for commands that have none, or where the reader's lab is not known. backend:
    named where it is not the default one.
    """
    words_of_line = ["labbook", name, *map(str, words)]
    words_of_line += [] if lab is None else ["--lab", str(lab)]
    words_of_line += [] if backend == DEFAULT_BACKEND else ["--backend", backend]
    return shlex.join(words_of_line)
