"""Reproduction of Zhao, Liebgott and Cachard (Acoustics 2012): a needle's axis and tip."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
