"""Detectors of a needle being inserted: something moved.

It holds the difference of volumes, the geometric median and the insertion detector. It imports
`signals` only, and none of `localization`, `estimation` and `control`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
