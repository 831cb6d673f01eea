"""Compiled kernels that sample images and volumes at points.

This room imports no other.
"""
