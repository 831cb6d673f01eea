"""The scanner's monitor: a page with the two slices through the needle.

Its pictures are drawn in the probe frame, on a thread of their own. It imports `display` and
everything that `display` imports.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
