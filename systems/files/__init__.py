"""Reading of typed YAML, and atomic writing of files.

Errors in a setting name its field. A file is written completely or not at all. The package imports
only `models`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
