"""Compiled kernels that sample images and volumes at points.

The package imports no other.
"""
