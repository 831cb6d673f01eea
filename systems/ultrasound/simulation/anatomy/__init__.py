"""Segmented anatomy as a phantom: label maps, their tables, and a synthetic liver."""
