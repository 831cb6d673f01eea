"""Sockets and messages of live connections.

A link keeps up one connection, or serves any number of peers; `open_igt_link` turns bytes into
items and back. This room imports `files` and `signals`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
