"""Typed YAML in, whole files out.

A setting is read with an error that names its field; a file is written whole or not at all.
This room imports `models` only.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
