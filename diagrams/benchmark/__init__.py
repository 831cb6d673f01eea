"""The benchmark of needle trackers: sequences of volumes, scores and their report."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
