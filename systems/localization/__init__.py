"""Localizers: where the needle is in one volume or slice.

It holds the choice of candidate voxels, RANSAC, the search for the tip, the speckle velocimeter
and the tracker of a cross-section. It imports `signals` only, and none of `detection`,
`estimation` and `control`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
