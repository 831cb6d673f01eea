"""An environment of Gymnasium: a robot follows a needle, and an agent in place of the servo."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
