"""Analyses of papers, each a package that adds to labbook by one object: see `Paper`.

A paper registers as any package from outside does, in its `pyproject.toml`:

    [project.entry-points."labbook.papers"]
    toy2025 = "my_package.toy2025:Toy2025"
"""

from labbook.report.paper import Draw, Drawing, Paper

__all__ = ["Draw", "Drawing", "Paper"]
