"""Estimation of a needle's shape from the cross-sections in axial slices."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
