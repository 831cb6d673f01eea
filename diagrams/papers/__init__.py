"""Reproductions of published experiments, one package per paper, and their registry.

They import `studies`, `diagrams` and `systems`, but not `app`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
