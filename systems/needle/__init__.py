"""Models of a needle and its insertion.

The package contains the path that a bevelled needle cuts (the bicycle model, in a plane and in
space), the motion by hand or through a template, the insertion composed of the two, and the hand
that follows a plan or an operator. It imports only `signals`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
