"""Reports of runs: verdict, plots, key frames, pages and movies."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
