"""Kernels of the CPU backend, in the words of `labbook_dem.words` and with the features of `features` as constants.

`labbook_numba.build` puts their source together with the physics into one generated module per specialisation.
"""
