"""Errors of a scanner's motor, of its clock, and of the connection that its sweeps come by."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
