"""Filters: where the needle is, given all volumes so far.

It holds the Kalman filters of a needle and the estimators of a bent needle's shape. It imports
`signals` only, and none of `detection`, `localization` and `control`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
