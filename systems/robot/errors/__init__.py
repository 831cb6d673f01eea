"""Errors of the probe's measured pose: calibration of arm and probe, and delay."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
