"""What a needle is and how it is pushed.

It holds the path that a bevelled needle cuts (the bicycle model, in a plane and in space), the
motion by hand or through a template, the insertion composed of the two, and the hand that follows a
plan or an operator. It imports `signals` only.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
