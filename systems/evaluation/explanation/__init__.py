"""What a tracker looked at around a loss: kept while it runs, drawn afterwards.

It imports the log of a run from the room around it, `signals` and `files`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
