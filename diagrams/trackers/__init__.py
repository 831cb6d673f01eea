"""Needle trackers, and the registry from which a scenario selects one.

A new tracker is a file here and a line in `registry`. A published one lies in its paper's folder.
This room imports `systems` and `published` only.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
