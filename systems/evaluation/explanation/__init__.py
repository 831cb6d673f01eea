"""Explanations of a tracker's decisions around a loss: recorded during a run, drawn afterwards.

This room imports the log of a run from `evaluation`, and `signals`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
