"""What a needle is and how it is pushed.

It holds the bicycle model of a bevelled needle, insertions with a straight or a bevelled tip,
and the hand that follows a plan or an operator. It imports `signals` only.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
