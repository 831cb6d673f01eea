"""Commands that exchange data with other programs: serve a run, track and bridge live volumes.

Only the command line's modules import this room.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
