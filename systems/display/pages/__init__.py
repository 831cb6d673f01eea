"""The one door to every page of a run: a server that checks who asks, and Meshcat behind it."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
