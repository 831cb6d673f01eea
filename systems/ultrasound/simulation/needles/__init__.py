"""Echo of a needle: levels, surface of the tip, and rendering."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
