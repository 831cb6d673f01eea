"""The world view, drawn with Drake's Meshcat.

It shows probe, phantom, needle, estimate and slices, and holds an operator's controls. It
imports `display` and what `display` imports.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
