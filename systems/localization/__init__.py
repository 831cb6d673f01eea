"""Localizers, which find the needle in one volume or slice.

The package contains the choice of candidate voxels, RANSAC, the search for the tip, the speckle
velocimeter and the localizer of a cross-section. It imports only `signals` and `sampling`, and none
of `detection`, `estimation` and `control`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
