"""Shapes along a path in C++; the plain twin is ``carried_shapes`` in covariance.py."""
