"""Needle trackers: what each is made of, and the registry among which a scenario chooses.

A new tracker is a file here and a line in `registry`. It imports `systems` only.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
