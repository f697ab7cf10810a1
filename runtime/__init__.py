"""Run time: load generated code, fly it on the host or an emulated target, measure and report.

Nothing in this package imports SymPy, CasADi or the compile-time stages.
"""
