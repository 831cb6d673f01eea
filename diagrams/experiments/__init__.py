"""Experiments: a needle is followed, or its shape predicted; their scenarios and the registry.

It imports the diagrams beside it, but neither `studies`, `papers` nor `app`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
