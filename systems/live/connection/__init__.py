"""Sockets and protocols of live connections.

A link keeps up one connection, or serves any number of peers; a protocol turns bytes into items and
back. A new protocol is a module and a line in `protocols`. This room imports `files` and `signals`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
