"""Simulated scanner: tissue, echoes and sweeps.

The renderer computes the sweep that a scanner would acquire of tissue and needle; the scanner
outputs it. This room imports `ultrasound` and everything that `ultrasound` imports.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
