"""Reproduction of Carriere et al. (AIM 2016): prediction of the shape of needles."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
