"""Study of robustness: what the trackers survive when the dials of the harder world are turned."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
