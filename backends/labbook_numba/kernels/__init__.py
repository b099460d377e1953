"""Kernels of the CPU backend, in the vocabulary of `labbook_dem.words`, with the switches of `features` as constants.

`labbook_numba.build` joins their source with the physics into one generated module a specialisation.
"""
