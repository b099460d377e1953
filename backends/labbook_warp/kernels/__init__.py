"""Kernels, written in the vocabulary of `labbook_dem.words` and `words`, generated into one module a specialisation."""
