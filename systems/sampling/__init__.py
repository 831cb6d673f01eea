"""Compiled kernels that sample images at points."""
