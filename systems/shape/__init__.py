"""Cross-sections of a needle in axial slices, and estimators of a bevelled needle's shape.

The package imports only `signals`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
