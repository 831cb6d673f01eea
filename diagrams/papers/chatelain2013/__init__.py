"""Reproduction of Chatelain, Krupa and Marchal (ICRA 2013): needles are found and followed."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
