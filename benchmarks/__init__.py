"""Measured figures: against other solvers (``run``) and on real data (``real_data``). Not part of the package."""
