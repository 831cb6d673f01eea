"""Detectors of a needle's insertion from the motion it causes.

The package contains the difference of volumes, the geometric median and the insertion detector. It
imports only `signals`, and none of `localization`, `estimation` and `control`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
