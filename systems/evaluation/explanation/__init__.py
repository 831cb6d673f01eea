"""Explanations of a tracker's decisions around a loss: recorded in a run, drawn afterwards."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
