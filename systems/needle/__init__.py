"""Models of a needle and its insertion: the path, the motion, and the hand that pushes it."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
