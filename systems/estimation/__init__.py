"""Filters that estimate the needle from all volumes so far.

The package contains the Kalman filters of a needle and the estimators of a bent needle's shape. It
imports only `signals`, and none of `detection`, `localization` and `control`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
